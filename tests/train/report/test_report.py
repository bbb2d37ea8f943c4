"""The page of training runs: one file, small, that says what it shows and what it cannot show."""

import re
import sys
import time
from xml.etree import ElementTree

import numpy as np
import pytest
from fixtures.workdirs import make_rows

from ha2g_jax import cli
from ha2g_jax.errors import UserError
from ha2g_jax.train.report import samples
from ha2g_jax.train.report.lines import make_lines
from ha2g_jax.train.report.report import write_report
from ha2g_jax.train.report.runs import read_runs

pytest.importorskip("matplotlib")


@pytest.fixture
def write(tmp_path):
    """A function that writes the page of runs without pictures of motion and returns its text."""

    def write(*paths, **options):
        return write_report(paths, tmp_path / "page.html", **{"num_clips": 0, **options}).read_text()

    return write


def charts(page):
    """Return the label of each chart -> its element, which must be XML."""
    texts = re.findall(r'<svg viewBox="[^"]*" role="img".*?</svg>', page, re.DOTALL)
    found = [ElementTree.fromstring(text) for text in texts]
    return {element.attrib["aria-label"].split(" by step")[0]: element for element in found}


def drawn(element):
    """Return the classes of the groups of a chart, one for each curve, band or thin line."""
    return [group.attrib["class"] for group in element.iter() if group.attrib.get("class", "").startswith("line-")]


def test_every_metric_has_a_chart_with_a_table(make_run, write):
    page = write(make_run())
    assert list(charts(page)) == [
        "huber, training",
        "huber, validation",
        "gan, training",
        "norm of the gradient, generator",
        "learning rate, generator",
        "steps per second",
        "windows per second",
    ]
    assert page.count("<thead>") == 1 + 7
    assert re.search(r"steps per second.*?<td>10</td><td>1,000</td>", page, re.DOTALL)  # 40 windows in batches of 4


def test_the_page_needs_nothing_else(make_run, write):
    page = write(make_run())
    assert "default-src 'none'" in page and "<script" not in page
    assert set(re.findall(r"https?://[^\"' ]+", page)) <= {"http://www.w3.org/1999/xlink", "http://www.w3.org/2000/svg"}
    ids = re.findall(r'\bid="([^"]+)"', page)
    assert len(ids) == len(set(ids))


def test_axes_have_readable_numbers(make_run, write):
    page = write(make_run())
    texts = {label: [text.text for text in chart.iter("text")] for label, chart in charts(page).items()}
    assert {"0.2", "0.4", "0.6", "0", "1k"} <= set(texts["huber, training"])
    assert "0.0001" in texts["learning rate, generator"]  # constant, so that nothing is magnified but its rounding


def test_seeds_are_one_line_with_a_band(make_run, write):
    page = write(make_run("a"), make_run("b", seed=1), make_run("c", **{"train.learning_rate": 0.01}))
    assert "2 runs, seeds 0, 1" in page and "learning_rate=0.01" in page
    curves = drawn(charts(page)["huber, training"])
    assert curves == ["line-0", "line-0", "line-1", "line-1"]  # band and mean, then values as logged and their mean
    assert "train.learning_rate</th><td>0.0005</td><td>0.01" in page


def test_names_of_runs_are_text(make_run, write):
    page = write(make_run("<b>a & b"))
    assert "<b>a & b" not in page and "&lt;b&gt;a &amp; b" in page
    charts(page)


def test_equal_runs_give_equal_pages(make_run, write):
    path = make_run()
    assert write(path) == write(path)


def test_values_that_are_not_finite_are_counted(make_run, write):
    rows = make_rows()
    rows[3]["loss/gan"] = float("nan")
    assert "1 logged values are not finite and left out" in write(make_run(rows=rows))


def test_one_row_is_enough_and_none_is_said(make_run, write):
    assert "huber, training" in charts(write(make_run("one", rows=make_rows()[:1])))
    assert "No run has written metrics yet." in write(make_run("none", rows=[]))


def test_states_and_reasons_are_listed(make_run, write):
    damaged = make_run("damaged")
    (damaged / "config.json").write_text("{")
    page = write(make_run("good", is_finished=True), make_run("bad", failure="disk <full>", seed=3), damaged)
    assert "bad failed: disk &lt;full&gt;" in page and "damaged damaged: " in page and "<td>finished</td>" in page


def test_a_page_of_damaged_runs_is_refused(make_run, tmp_path, write):
    (make_run("a") / "config.json").write_text("{")
    with pytest.raises(UserError, match="a cannot be read"):
        write(tmp_path)


def test_a_hundred_thousand_rows_take_seconds_and_little_space(make_run, write):
    path = make_run(rows=make_rows(steps=1_000_000, every=10, validate_every=10_000), **{"train.steps": 1_000_000})
    start = time.process_time()
    page = write(path)
    assert time.process_time() - start < 20  # 3 s on an idle core
    assert len(page) < 300_000
    (logged, mean) = (
        np.array(re.findall(r"[ML] [\d.]+ ([\d.]+)", group[1].attrib["d"]), float)
        for group in charts(page)["huber, training"].iter()
        if group.attrib.get("class") == "line-0"
    )
    assert len(mean) == 240 and 240 < len(logged) <= 480
    assert np.abs(np.diff(mean)).max() < 20  # smooth


def test_smoothing_is_as_asked(make_run, write):
    path = make_run()
    assert "running means over 40 steps" in write(path)
    assert "running means over 500 steps" in write(path, smoothing=0.5)
    assert "Curves are not smoothed." in write(path, smoothing=0)


def test_motion_that_cannot_be_drawn_is_explained(make_run, write, tmp_path):
    page = write(make_run("a"), num_clips=1)
    assert "a: no pictures: no checkpoint yet" in page and "<img" not in page
    lost = make_run("b")
    (lost / "best" / "500").mkdir(parents=True)
    assert "no pictures: no corpus in" in write(lost, num_clips=1)


def test_motion_is_drawn_below_the_recorded_motion(make_run, tiny_talk, debug_model, monkeypatch):
    path = make_run(corpus=tiny_talk)
    (path / "best" / "500").mkdir(parents=True)
    monkeypatch.setattr("ha2g_jax.synthesis.load", lambda _: debug_model)
    found = samples.make_samples(make_lines(read_runs([path])), 1)
    if "another one" in found.notes["run"]:
        pytest.skip("the debug model has another skeleton")
    (clip,) = found.clips
    assert [strip.label for strip in clip.strips] == ["recorded", "run"]
    assert found.notes["run"] == "run, checkpoint of step 500"
    assert clip.strips[0].picture != clip.strips[1].picture


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nothing"], "nothing does not exist"),
        (["."], "no run in"),
        (["run", "-o", "page.txt"], "name it page.txt.html"),
        (["run", "-o", "missing/page.html"], "no folder missing"),
        (["run", "--smooth", "2"], "smoothing is 2"),
        (["run", "--samples", "-1"], "number of clips is -1"),
    ],
)
def test_mistakes_are_answered_in_one_line(arguments, said, make_run, tmp_path, monkeypatch, capsys):
    if arguments[0] == "run":
        make_run()
    monkeypatch.chdir(tmp_path)
    assert cli.main(["plot", *arguments]) == 2
    printed = capsys.readouterr().err
    assert said in printed and printed.count("\n") == 1
    assert not list(tmp_path.rglob("*.html"))


def test_a_missing_library_is_named_with_its_extra(make_run, tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert cli.main(["plot", str(make_run()), "-o", str(tmp_path / "page.html")]) == 2
    assert "pip install 'ha2g-jax[plot]'" in capsys.readouterr().err


def test_the_command_prints_the_path_of_the_page(make_run, tmp_path, capsys):
    out = tmp_path / "page.html"
    assert cli.main(["plot", str(make_run().parent), "-o", str(out), "--samples", "0"]) == 0
    assert capsys.readouterr().out == f"{out}\n" and out.stat().st_size > 10_000
