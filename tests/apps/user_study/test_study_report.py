"""The report: all parts are there, free text is shown and never run, and degenerate studies are reported honestly."""

import json
import re
from xml.etree import ElementTree

import numpy as np
import pytest
from fixtures.pages import Page
from fixtures.simulated_study import make_answers, write_study

from ha2g_jax import cli
from ha2g_jax.apps.user_study import analysis, study_report
from ha2g_jax.apps.user_study.design import read_key

HOSTILE = (
    "<script>alert(1)</script> <img src=x onerror=alert(1)> [x](javascript:alert(1)) ![y](//z) | `a` \u202e\x07 --> $x$"
)


@pytest.fixture
def folder(tmp_path):
    write_study(tmp_path, 6, title="Gestures <b>of</b> $body")
    return tmp_path


def run(folder):
    return analysis.analyse([folder / "answers"], folder / "study")


def add(folder, name, **changes):
    key = read_key(folder / "study")
    content = make_answers(key, name, np.random.default_rng(99)) | changes
    (folder / "answers" / f"{name}.json").write_text(json.dumps(content))


def test_the_page_has_all_parts_and_no_script(folder):
    add(folder, "hostile", comments=HOSTILE)
    (folder / "answers" / "x<script>alert(2)<!--.json").write_text("{")
    page = study_report.write_report(run(folder), folder / "report")
    found = Page(page.read_text())
    assert not found.tags & {"script", "iframe", "object", "link", "a"} and found.tags >= {"table", "img", "h2"}
    assert not any(name.startswith("on") for name in found.attributes)
    assert "default-src 'none'" in page.read_text() and "http" not in page.read_text().replace("http-equiv", "")
    parts = ("Mean opinion scores", "Differences", "Preferences", "Matched", "Agreement", "Excluded", "Comments")
    assert all(heading in found.text for heading in parts)
    assert "<script>alert(1)</script> <img src=x onerror=alert(1)>" in found.text and "\u202e" not in page.read_text()
    assert "Gestures <b>of</b> $body" in found.text and "x<script>alert(2)<!--.json" in found.text
    charts = sorted(path.name for path in (folder / "report").glob("*.svg"))
    assert charts == sorted(f"{name}.svg" for name in study_report.CHARTS)
    for name in charts:
        ElementTree.parse(folder / "report" / name)
        assert f"]({name})" in (folder / "report" / "report.md").read_text()


def test_charts_of_an_earlier_report_are_removed(folder):
    study_report.write_report(run(folder), folder / "report")
    write_study(folder / "other", 3, num_systems=1)
    page = study_report.write_report(run(folder / "other"), folder / "report")
    charts = {path.stem for path in page.parent.glob("*.svg")}
    assert charts == set(re.findall(r"\]\((\w+)\.svg\)", page.with_suffix(".md").read_text()))
    assert charts < set(study_report.CHARTS)


def test_markdown_shows_free_text_as_it_is(folder):
    add(folder, "hostile", comments=HOSTILE)
    text = study_report.as_markdown(run(folder))
    assert "<script" not in text and "<img" not in text and "\x07" not in text
    (row,) = (line for line in text.splitlines() if line.startswith("| hostile"))
    assert r"\[x\](javascript:alert(1))" in row and r"!\[y\]" in row and r"\| \`a\`" in row and r"\$x\$" in row
    assert row.replace(r"\|", "").count("|") == 3


def test_numbers_of_a_report(folder):
    results = run(folder)
    report = study_report.write_report(results, folder / "report").with_suffix(".json")
    assert json.loads(report.read_text()) == results
    scale = results["opinion"]["scales"]["naturalness"]
    assert scale["means"]["system a"]["value"] > scale["means"]["system c"]["value"]
    (ab, ac, bc) = scale["differences"]
    assert ac["value"] == pytest.approx(ab["value"] + bc["value"])
    assert ac["p_holm"] >= ac["p"]
    assert results["answers"] == {"rating": 72, "preference": 72, "mismatch": 72, "attention": 6}
    assert {each["system"] for each in results["mismatch"]["systems"]} == {"system a", "system b", "system c"}
    assert sum(results["preference"]["strengths"][f"system {x}"]["value"] for x in "abc") == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize("num_participants", [1, 2])
@pytest.mark.parametrize("settings", [{"num_systems": 1}, {"num_clips": 2}, {"per_participant": {"rating": 3}}])
def test_small_studies(settings, num_participants, tmp_path):
    write_study(tmp_path, num_participants, **settings)
    results = run(tmp_path)
    page = study_report.as_markdown(results)
    assert len(results["participants"]) == num_participants
    if num_participants == 1:
        assert "no intervals" in page and results["opinion"]["scales"]["synchrony"]["means"]["system a"]["low"] is None


def test_nobody_is_left(folder, capsys):
    for path in (folder / "answers").iterdir():
        path.write_text("{}")
    assert cli.main(["study", "analyse", str(folder / "answers"), "--study", str(folder / "study")]) == 1
    assert "nothing to analyse" in capsys.readouterr().out
    results = run(folder)
    assert not results["participants"] and len(results["excluded"]) == 6 and results["opinion"] is None


def run_with(folder, num_participants, **choices):
    """Return the results of a study whose participants choose as `make_answers` is told."""
    key = write_study(folder, 0)
    for number in range(num_participants):
        content = make_answers(key, f"p{number}", np.random.default_rng(number), **choices)
        (folder / "answers" / f"p{number}.json").write_text(json.dumps(content))
    return run(folder)


def test_a_system_that_is_never_chosen(tmp_path):
    results = run_with(tmp_path, 8, prefer=lambda first, second: 1.0 if second == 2 else 0.6)
    worst, page = results["preference"]["strengths"]["system c"], study_report.as_markdown(results)
    assert worst["low"] == "-inf" and not worst["is_finite"]
    assert "no bound" in page and "Always or never preferred" in page


def test_choices_for_neither_alone(tmp_path):
    results = run_with(tmp_path, 3, equal=1.0)
    assert results["preference"]["pairs"][0]["value"] is None and "no strengths" in study_report.as_markdown(results)


def test_command(folder, capsys):
    arguments = ["study", "analyse", str(folder / "answers"), "--study", str(folder / "study")]
    assert cli.main(arguments) == 0
    assert capsys.readouterr().out.startswith("# User study: Gestures")
    assert cli.main([*arguments, "-o", str(folder / "report")]) == 0
    assert capsys.readouterr().out.strip() == str(folder / "report" / "report.html")
