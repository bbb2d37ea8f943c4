"""Runs are read from their workdirs, listed with what differs, and drawn: seeds are a mean and a band."""

import json
import os
import re
from xml.etree import ElementTree

import numpy as np
import pytest
from fixtures.workdirs import make_rows, write_run
from PIL import Image

from ha2g_jax import cli
from ha2g_jax.cli import train
from ha2g_jax.errors import UserError
from ha2g_jax.train import runs
from ha2g_jax.train.plot import align_seeds, running_mean, write_plot
from ha2g_jax.train.runs import common_differing, differing, find_workdirs, make_lines, read_runs, short_names
from ha2g_jax.train.workdir import LOCK, only_run


@pytest.fixture
def make_run(tmp_path):
    """A function that writes a workdir by the name of a run, which is a path below `tmp_path`."""
    return lambda name="run", *arguments, **options: write_run(tmp_path / name, *arguments, **options)


def read(workdir):
    (run,) = read_runs([workdir])
    return run


def test_states(make_run):
    assert read(make_run("a", is_finished=True)).state == "finished"
    stopped = make_run("b")
    (stopped / LOCK).touch()
    assert read(stopped).state == "stopped"
    with only_run(stopped):  # a look at a run does not keep it from training
        pass
    failed = read(make_run("c", failure="XlaRuntimeError: out of memory"))
    assert (failed.state, failed.reason) == ("failed", "XlaRuntimeError: out of memory")
    running = make_run("d", failure="of an earlier start")
    with only_run(running):
        assert read(running).state == "running"
    assert read(running).state == "failed"


def test_a_run_whose_networks_are_being_initialised_is_not_damaged(tmp_path):
    (tmp_path / "run").mkdir()
    with only_run(tmp_path / "run"):
        assert read(tmp_path / "run").state == "running"
    assert read(tmp_path / "run").state == "stopped"
    with pytest.raises(UserError, match="cannot be read \\(it has not begun\\)"):
        write_plot([tmp_path / "run"], tmp_path / "a.html")


def test_a_run_with_damaged_metrics_is_left_out_of_the_curves(make_run, tmp_path, caplog):
    pytest.importorskip("matplotlib")
    folders = [make_run("a"), make_run("b")]
    lines = (folders[1] / "metrics.jsonl").read_text().splitlines()
    (folders[1] / "metrics.jsonl").write_text("\n".join(["garbage", *lines]))
    write_plot(folders, tmp_path / "a.html")
    assert "its curves are left out" in caplog.text


def test_a_step_that_was_not_finite_fails_a_run_until_it_is_continued_beyond_it(make_run):
    report = json.dumps({"step": 1010, "not_finite": ["loss/kld", "loss/gan"], "windows": []})
    workdir = make_run()
    (workdir / "failed.json").write_text(report)
    assert read(workdir).reason == "loss/kld, loss/gan not finite at step 1010"
    with (workdir / "metrics.jsonl").open("a") as file:
        file.write('{"step": 1050, "loss/huber": 0.1}\n')
    assert read(workdir).state == "stopped"


def test_progress_and_best_score(make_run):
    scores = {20: 0.3, 30: float("nan"), 40: 0.2, 50: 0.4}
    rows = [{"step": 10, "loss/huber": 1.0}]
    rows += [{"step": step, "validation/loss/huber": score} for step, score in scores.items()]
    rows += [{"step": 60, "loss/huber": 0.1}]
    workdir = make_run(rows=rows)
    with (workdir / "metrics.jsonl").open("a") as file:
        file.write('{"step": 70, "validation/loss/hu')  # as a kill leaves it
    run = read(workdir)
    assert (run.step, run.steps) == (60, 1000)
    assert run.best == ("loss/huber", 0.2, 40)
    run = read(make_run("new", rows=[]))
    assert (run.state, run.step, run.best) == ("stopped", 0, None)


def test_a_damaged_run_is_listed_with_its_reason(make_run, tmp_path, capsys):
    make_run("good", is_finished=True)
    (make_run("bad") / "config.json").write_text("")
    (make_run("worse") / "metrics.jsonl").write_text("12\n")
    assert cli.main(["runs", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert [line.split()[0] for line in printed.splitlines()[:4]] == ["run", "bad", "good", "worse"]
    assert "bad: damaged, " in printed and "config" in printed
    assert "worse: damaged, metrics.jsonl has a damaged line" in printed


def test_runs_are_found_at_any_depth_and_nothing_below_them(make_run, tmp_path):
    paths = [make_run(name) for name in ("a", "sweep/b", "sweep/deep/c")]
    (paths[0] / "wandb").mkdir()
    (paths[0] / "wandb" / "run.json").touch()
    (tmp_path / "model").mkdir()
    (tmp_path / "model" / "config.json").touch()
    assert find_workdirs(tmp_path) == paths
    assert [run.name for run in read_runs(paths)] == ["a", "sweep/b", "sweep/deep/c"]
    assert find_workdirs(paths[0]) == paths[:1]


def test_table_has_the_settings_that_differ(make_run, tmp_path, capsys):
    make_run("a", is_finished=True)
    make_run("b", failure="no space left", **{"train.learning_rate": 0.01})
    assert cli.main(["runs", str(tmp_path)]) == 0
    head, first, second, _, note = capsys.readouterr().out.splitlines()
    assert head.split("  ")[0] == "run" and "learning_rate" in head and "best huber" in head and "seed" not in head
    assert first.split()[:5] == ["a", "0.0005", "1000", "/", "1000"] and "finished" in first
    assert second.split()[1] == "0.01" and note == "b: failed, no space left"
    assert cli.main(["runs", str(tmp_path), "--json"]) == 0
    first, second = json.loads(capsys.readouterr().out)
    assert second["settings"] == {"train.learning_rate": 0.01}
    assert first["best"].keys() == {"name", "value", "step"} and first["path"] == str(tmp_path / "a")


@pytest.mark.parametrize(
    ("sort", "names"),
    [("name", "abc"), ("step", "bca"), ("best", "bac"), ("state", "bac"), ("changed", "cba")],
)
def test_orders(make_run, tmp_path, sort, names):
    for number, (name, step, score) in enumerate([("a", 20, 0.3), ("b", 1000, 0.2), ("c", 30, 0.4)]):
        rows = [{"step": step, "validation/loss/huber": score}]
        workdir = make_run(name, rows=rows, is_finished=name == "b")
        os.utime(workdir / "metrics.jsonl", (number, number))
    assert "".join(run.name for run in runs.list_runs([tmp_path], sort)) == names
    assert tuple(runs.SORTS) == train._SORTS


def test_seeds_of_a_config_are_one_line(make_run):
    rates = [(rate, seed) for rate in (1e-4, 1e-3) for seed in (0, 1)]
    found = read_runs(make_run(f"{rate}-{seed}", seed=seed, **{"train.learning_rate": rate}) for rate, seed in rates)
    lines = make_lines(found)
    assert [line.label for line in lines] == ["learning_rate=0.0001", "learning_rate=0.001"]
    assert [[run.name for run in line.runs] for line in lines] == [["0.0001-0", "0.0001-1"], ["0.001-0", "0.001-1"]]
    assert set(differing(found)) == {"seed", "train.learning_rate"}
    # Runs with one config and one seed are lines of their own.
    lines = make_lines(read_runs([make_run("a"), make_run("b"), make_run("c", seed=1)]))
    assert [line.label for line in lines] == ["a", "b", "c"]


def test_settings_of_another_method_are_told_by_its_name(make_run):
    from ha2g_jax.config import presets

    other = make_run("b")
    (other / "config.json").write_text(presets.parse("talk:debug", "seq2seq").to_json())
    found = read_runs([make_run("a"), other])
    assert "method" in common_differing(found) and "loss.ha2g.weights.gan" not in common_differing(found)
    assert "loss.ha2g.weights.gan" in differing(found)


def test_names_are_as_short_as_they_can_be_told_apart():
    short = short_names(["loss.ha2g.weights.gan", "loss.ha2g.gan", "train.steps"])
    assert list(short.values()) == ["weights.gan", "ha2g.gan", "steps"]


def test_curves_are_running_means_and_seeds_are_compared_at_all_of_their_steps():
    steps, values = np.arange(0.0, 100, 10), np.arange(10.0) ** 2
    means = running_mean(steps, values, 20.0)
    assert means[[0, 5, 9]] == pytest.approx([np.mean([0, 1]), np.mean([16, 25, 36]), np.mean([64, 81])])
    np.testing.assert_array_equal(running_mean(steps, values, 0.0), values)
    at, both = align_seeds([(np.array([0, 20]), np.array([0, 2])), (np.array([0, 10, 30]), np.array([0, 3, 5]))])
    assert at.tolist() == [0, 10, 20, 30]
    np.testing.assert_array_equal(both, [[0, 1, 2, np.nan], [0, 3, 4, 5]])


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


def test_seeds_that_share_one_step_are_seen(make_run, write):
    rows = [row for row in make_rows() if "loss/huber" in row]
    page = write(make_run("a", rows=rows[:1]), make_run("b", seed=1, rows=rows), smoothing=0)
    assert page.count("<use") > write(make_run("c", rows=rows), make_run("d", seed=1, rows=rows), smoothing=0).count(
        "<use"
    )


def test_gaps_and_single_rows_are_drawn_and_runs_without_metrics_are_said(make_run, write):
    rows = make_rows()
    rows[3]["loss/gan"] = float("nan")
    page = write(make_run("_$a^$", rows=rows), make_run("b", rows=rows[:1]), smoothing=0)
    assert {"loss/gan", "_$a^$", "b"} <= set(texts(page)) and "Curves are not smoothed" in page
    assert "No run has written metrics yet." in write(make_run("none", rows=[]))


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["runs", "empty"], "no run in empty"),
        (["plot", "run", "-o", "page.txt"], "name it page.html or .png"),
    ],
)
def test_mistakes_are_answered_in_one_line(arguments, said, make_run, tmp_path, monkeypatch, capsys):
    make_run()
    (tmp_path / "empty").mkdir()
    monkeypatch.chdir(tmp_path)
    assert cli.main(arguments) == 2
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
