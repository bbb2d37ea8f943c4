"""The curves of runs: seeds are a mean and a band, and the page needs nothing else."""

import re
from xml.etree import ElementTree

import numpy as np
import pytest
from fixtures.workdirs import make_rows
from PIL import Image

from ha2g_jax import cli
from ha2g_jax.train.plot import make_curves, running_mean, write_plot
from ha2g_jax.train.runs import make_lines, read_runs


def series(steps, values):
    return np.array(steps, float), np.array(values, float)


def test_the_running_mean_is_that_of_the_window():
    steps, values = series(range(0, 100, 10), np.arange(10.0) ** 2)
    means = running_mean(steps, values, np.array([0.0, 50.0, 90.0]), 20.0)
    assert means == pytest.approx([np.mean([0, 1]), np.mean([16, 25, 36]), np.mean([64, 81])])
    assert running_mean(steps, values, steps, 0.0) == pytest.approx(values)


def test_a_mean_is_joined_over_a_gap_and_ends_with_the_values():
    means = running_mean(*series([10, 30], [1, 3]), np.array([0.0, 10.0, 20.0, 30.0, 40.0]), 0.0)
    np.testing.assert_allclose(means, [np.nan, 1, 2, 3, np.nan])
    assert running_mean(*series([5], [2]), np.array([5.0]), 100.0).tolist() == [2]


@pytest.fixture
def two_seeds(make_run):
    """A line of two seeds, a and b, another line, c, and a function that returns what they logged as "x"."""
    lines = make_lines(read_runs([make_run("a"), make_run("b", seed=1), make_run("c", **{"train.batch_size": 8})]))

    def log(**found):
        runs = [run for line in lines for run in line.runs]
        return {run.path: {"x": found[run.name]} if run.name in found else {} for run in runs}

    return lines, log


def test_seeds_that_are_logged_at_other_steps_are_compared_at_all_of_them(two_seeds):
    lines, log = two_seeds
    metrics = log(a=series([0, 20], [0, 2]), b=series([0, 10, 20], [0, 3, 4]))
    (curve,) = make_curves("x", lines, metrics, 0.0)
    assert curve.line == 0 and curve.steps.tolist() == [0, 10, 20] and curve.means.tolist() == [[0, 1, 2], [0, 3, 4]]


def test_a_metric_of_some_lines_is_a_curve_of_these(two_seeds):
    lines, log = two_seeds
    (curve,) = make_curves("x", lines, log(c=series([1], [2])), 0.0)
    assert curve.line == 1 and curve.means.tolist() == [[2]]
    assert make_curves("y", lines, log(), 0.0) == []


def test_means_of_a_long_run_are_those_of_all_its_values(two_seeds):
    lines, log = two_seeds
    values = np.random.default_rng(0).normal(size=100_000)
    (curve,) = make_curves("x", lines, log(a=series(range(100_000), values)), 0.0)
    assert len(curve.steps) == 240 and curve.means[0, 1:-1].mean() == pytest.approx(values.mean(), abs=1e-3)
    assert curve.means.std() < 0.1


@pytest.fixture
def write(tmp_path):
    """A function that writes the page of runs and returns its text."""
    pytest.importorskip("matplotlib")
    return lambda *paths, **options: write_plot(paths, tmp_path / "page.html", **options).read_text()


def texts(page):
    """Return the texts of the picture, which must be XML."""
    picture = ElementTree.fromstring(page[page.index("<svg") : page.rindex("</svg>") + len("</svg>")])
    return [element.text or "" for element in picture.iter("{http://www.w3.org/2000/svg}text")]


def test_every_metric_has_a_chart(make_run, write):
    page = write(make_run())
    assert [text for text in texts(page) if "/" in text or "second" in text] == [
        "loss/huber",
        "validation/loss/huber",
        "loss/gan",
        "grad_norm/generator",
        "learning_rate/generator",
        "windows_per_second",
        "steps_per_second",
    ]
    assert not any("+" in text for text in texts(page))  # constants are not magnified to show their rounding
    assert "finished" not in page and "stopped" in page
    assert "<script" not in page and "<img" not in page and not re.search(r'(href|src)="(?!#)', page)


def test_seeds_are_one_line_with_a_band(make_run, write):
    page = write(
        make_run("<b>a & b"), make_run("b", seed=1), make_run("c", **{"train.learning_rate": 0.01}), smoothing=0.5
    )
    assert {"learning_rate=0.0005", "learning_rate=0.01"} <= set(texts(page))
    assert page.count('id="line-0"') == 2 * page.count('id="line-1"')  # mean and band
    assert "running means over 500 steps" in page
    assert "<b>a & b" not in page and "&lt;b&gt;a &amp; b" in page


def test_gaps_and_single_rows_are_drawn_and_runs_without_metrics_are_said(make_run, write):
    rows = make_rows()
    rows[3]["loss/gan"] = float("nan")
    page = write(make_run("a", rows=rows), make_run("b", rows=rows[:1]), smoothing=0)
    assert "loss/gan" in texts(page) and "Curves are not smoothed" in page
    assert "No run has written metrics yet." in write(make_run("none", rows=[]))


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["."], "no run in"),
        (["run", "-o", "page.txt"], "name it page.html or .png"),
        (["run", "--smooth", "2"], "smoothing is 2"),
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


def test_the_command_writes_a_page_or_a_picture_and_prints_its_path(make_run, tmp_path, capsys):
    pytest.importorskip("matplotlib")
    folder = str(make_run().parent)
    for name in ("page.html", "curves.svg", "curves.png"):
        assert cli.main(["plot", folder, "-o", str(tmp_path / name)]) == 0
        assert capsys.readouterr().out == f"{tmp_path / name}\n" and (tmp_path / name).stat().st_size > 10_000
    with Image.open(tmp_path / "curves.png") as picture:
        assert picture.width > 800
