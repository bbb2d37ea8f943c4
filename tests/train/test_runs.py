"""The state of a run is read from its workdir, also of one that is damaged, and 500 of them are listed in seconds."""

import json
import os

import pytest

from ha2g_jax import cli
from ha2g_jax.cli import train
from ha2g_jax.train import runs
from ha2g_jax.train.runs import common_differing, differing, find_workdirs, make_lines, read_runs, short_names
from ha2g_jax.train.workdir import LOCK, only_run


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
    assert cli.main(["runs", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert [line.split()[0] for line in printed.splitlines()[:3]] == ["run", "bad", "good"]
    assert "bad: damaged, " in printed and "config" in printed


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


@pytest.mark.parametrize("path", ["nothing", "file", "empty"])
def test_a_folder_without_runs_is_an_error_of_the_user(tmp_path, capsys, path):
    (tmp_path / "file").touch()
    (tmp_path / "empty").mkdir()
    assert cli.main(["runs", str(tmp_path / path)]) == 2
    assert path in capsys.readouterr().err


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
