"""The table has every row and every value, says what its numbers are, and is not printed without sanity rows."""

import re

import pytest

from ha2g_jax.errors import UserError
from ha2g_jax.evaluation.evaluate import evaluate
from ha2g_jax.evaluation.scoring import make_results
from ha2g_jax.evaluation.table import CLOSER, _cell, as_markdown, as_table, section_markdown, section_table
from ha2g_jax.metrics import METRICS
from ha2g_jax.metrics.sanity import SANITY_ROWS


@pytest.fixture(scope="module")
def results(skeleton, perform, features):
    rows = {"late": perform(9, delay=0.25), "a method with a name that is far too long": perform(9, delay=0.1)}
    return evaluate(rows, perform(9), skeleton, autoencoder=features, draws=20, notes=("a note",))


def test_every_value_is_printed(results):
    table, markdown = section_table(results), section_markdown(results)
    for text in (table, markdown):
        for name in ("late", *SANITY_ROWS):
            assert name in text
        for key in {key for row in results["rows"].values() for key in row if row[key]["value"] is not None}:
            assert METRICS[key].heading in text
        fgd = results["rows"]["late"]["fgd"]
        assert f"{fgd['value']:.3f} [{fgd['low']:.3f}, {fgd['high']:.3f}]" in text
        assert "±" in text
        assert "SHA-256 0123456789abcdef, trained on toy" in text
        assert "a note" in text
        assert "BEAT alignment: " in text  # a flag
        assert "Paired differences" in text
        assert CLOSER in text and not re.search("[↑↓]", text)


def test_cells_of_a_terminal_stay_apart_and_short(results):
    parts = section_table(results).split("\n\n")
    cells = [line for part in parts for line in part.splitlines()[2:] if part.split("\n")[0] in _groups()]
    assert len(cells) > 30
    for line in cells:
        assert len(line) <= 120
        assert re.fullmatch(r".{24}( +(-|-?[\d.]+( ±[\d.]+)?( \[-?[\d.]+, -?[\d.]+\])?))+", line), line


def _groups():
    groups = {metric.group for metric in METRICS.values()}
    return groups | {f"{group}, continued" for group in groups}


def test_results_without_sanity_rows_are_not_printed(results):
    fewer = results | {"rows": {name: row for name, row in results["rows"].items() if name != "white jitter"}}
    for form in (section_table, section_markdown):
        with pytest.raises(UserError, match="lack white jitter"):
            form(fewer)


def test_numbers_keep_their_width():
    score = {"value": -0.0001, "low": -123456.0, "high": 12.345}
    assert _cell(score, METRICS["acceleration"]) == "0.00 [-123456, 12.3]"


def test_results_have_a_part_for_each_section_and_name_their_inputs(results):
    whole = make_results({"motion": "mine"}, {"first": results, "second": results})
    table, markdown = as_table(whole), as_markdown(whole)
    for text, headings in ((table, ("first:", "second:")), (markdown, ("## first", "## second"))):
        assert text.startswith("motion mine\n")
        first, second = (text.index(f"\n{heading}\n") for heading in headings)
        assert text.count("white jitter") == 2 * text[first:second].count("white jitter") > 2
    assert section_table(results) in table and section_markdown(results) in markdown
