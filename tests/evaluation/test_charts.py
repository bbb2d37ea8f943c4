"""Tables and charts of reports, re-read by parsers."""

import math
from xml.etree import ElementTree

import numpy as np
import pytest
from tables.curves import Panel, curve_chart

from ha2g_jax.evaluation.charts import Mark, histogram, html_table, interval_chart, markdown

_SVG = "{http://www.w3.org/2000/svg}"
_CHARTS = {
    "intervals": lambda: interval_chart(
        {"a $b$ <c>": {"x": Mark(1.0, 0.5, math.inf), "y": Mark(2.0)}, "d": {"x": Mark(math.nan)}},
        label="one & <two>",
        axis="score",
        reference=0,
    ),
    "curves": lambda: curve_chart(
        [Panel("a $b$ <c>", {"x": [Mark(0.1, 0.0, 0.2), Mark(math.nan), Mark(0.3)]}, reference=0.5), Panel("d", {})],
        ["0", "1", "file"],
        label="one & <two>",
        axis="score",
        is_last_apart=True,
    ),
    "histogram": lambda: histogram(
        [0, 3, 1], np.linspace(0, 3, 4), axis="score", label="one & <two>", curves={"a $b$ <c>": (1.0, 0.5)}
    ),
}


@pytest.mark.parametrize("draw", _CHARTS.values(), ids=_CHARTS)
def test_a_chart_is_the_same_document_each_time_with_its_names_as_text(draw):
    root = ElementTree.fromstring(draw())
    assert draw() == draw()
    assert root.get("role") == "img" and root.get("aria-label") == root.findtext(f"{_SVG}title") == "one & <two>"
    texts = {element.text for element in root.iter(f"{_SVG}text")}
    assert {"a $b$ <c>", "score"} <= texts
    ids = [name for element in root.iter() if (name := element.get("id"))]
    assert len(ids) == len(set(ids)) and not any(name.startswith(("figure", "axes")) for name in ids)


def test_cells_of_tables_are_text():
    assert markdown([("a", "b|c"), ("", "1")]) == "| a | b\\|c |\n| --- | --- |\n|   | 1 |"
    assert markdown([("a", "b")], has_numbers=True).endswith("| --- | ---: |")
    table = ElementTree.fromstring(html_table([("", "<b>"), ("x & y", "1")]))
    assert [cell.text for cell in table.iter("th")] == [None, "<b>", "x & y"]
