"""A sweep trains every point of a grid, goes on after failures and stops, and sums up over the seeds."""

import json
import os
import pathlib
import subprocess
import sys

import pytest
import sweep
from tables.plan import plan_grid

ROOT = pathlib.Path(__file__).parents[2]
CONFIG = f"{ROOT / 'experiments' / 'configs' / 'talk.py'}:debug"

# Stands for `ha2g train`: a run whose score is its learning rate plus its seed, and that fails with the seed 13.
STUB = """
import pathlib, json, sys
from ha2g_jax import launch
arguments = sys.argv[1:]
workdir = pathlib.Path(arguments[arguments.index("--workdir") + 1])
config = launch.load_config(arguments[1], arguments[4:])
if config.seed == 13:
    sys.exit("ha2g: an unlucky number")
workdir.mkdir()
score = config.train.learning_rate + config.seed
lines = [{"step": 1, "validation/loss/huber": 9.0}, {"step": 2, "validation/loss/huber": score}]
lines += [{"step": 2, "validation/loss/huber": 10.0}]
(workdir / "metrics.jsonl").write_text("".join(json.dumps(line) + "\\n" for line in lines))
(workdir / "config.json").write_text(config.to_json())
(workdir / "latest" / str(config.train.steps)).mkdir(parents=True)
"""


@pytest.fixture
def stub(tmp_path):
    path = tmp_path / "stub.py"
    path.write_text(STUB)
    return [sys.executable, str(path)]


def _flags(workdir, *grids):
    return ["--config", CONFIG, "--workdir", str(workdir), *(flag for grid in grids for flag in ("--grid", grid))]


def test_the_grid_is_a_product_with_readable_names(tmp_path):
    grids = ["train.betas=(0.5,0.999),(0.9, 0.999)", "seed=0,1"]
    runs = plan_grid(CONFIG, tmp_path, grids, ["--config.train.steps=7"])
    assert [run.name for run in runs] == [
        "betas=0.5,0.999,seed=0",
        "betas=0.5,0.999,seed=1",
        "betas=0.9,0.999,seed=0",
        "betas=0.9,0.999,seed=1",
    ]
    assert [(run.config.train.betas, run.config.seed) for run in runs[1:3]] == [((0.5, 0.999), 1), ((0.9, 0.999), 0)]
    assert {run.config.train.steps for run in runs} == {7}


def test_names_of_runs_differ_and_are_names_of_folders(tmp_path):
    paths = ["/a/b", "/a_b", "/long" * 80, "/long" * 80 + "er"]
    runs = plan_grid(CONFIG, tmp_path, [f"data.path={','.join(paths)}"])
    assert [run.config.data.path for run in runs] == paths
    assert len({run.name for run in runs}) == 4 and runs[0].name == "path=_a_b"
    for run in runs:
        run.workdir.mkdir()


@pytest.mark.parametrize(
    ("grids", "named"),
    [
        (["train.batch_sise=1,2"], "batch_size"),
        (["train.betas=(0.5,0.9"], "close the brackets"),
        (["seed=0,1,0"], "give every value once"),
    ],
)
def test_a_grid_that_cannot_be_used_starts_nothing(stub, tmp_path, capsys, grids, named):
    assert sweep.main(_flags(tmp_path / "runs", *grids), stub) == 2
    printed = capsys.readouterr().err
    assert named in printed and printed.count("\n") == 1
    assert not (tmp_path / "runs").exists()


def test_the_list_serves_a_slurm_array(tmp_path, capsys):
    assert sweep.main([*_flags(tmp_path, "seed=3,4"), "--list"]) == 0
    assert capsys.readouterr().out == "0\tseed=3\n1\tseed=4\n"
    assert not list(tmp_path.iterdir())


def test_a_task_of_a_slurm_array_trains_its_run(stub, tmp_path):
    code = f"import sys; sys.path.insert(0, {str(ROOT / 'experiments')!r}); import sweep; "
    code += f"sys.exit(sweep.main({_flags(tmp_path / 'runs', 'seed=3,4')!r}, {stub!r}))"
    for task, expected in (("1", 0), ("2", 2)):
        environment = os.environ | {"SLURM_ARRAY_TASK_ID": task}
        done = subprocess.run(
            [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == expected
    assert "the grid has 2 runs: use --array=0-1" in done.stderr
    assert [path.name for path in (tmp_path / "runs").iterdir()] == ["seed=4"]


def test_a_sweep_reports_failures_and_means_over_seeds(stub, tmp_path, capsys):
    flags = _flags(tmp_path / "runs", "train.learning_rate=0.25,0.5", "seed=1,3,13")
    assert sweep.main(flags, stub) == 1
    printed, progress = capsys.readouterr()
    assert progress.count("failed: ha2g: an unlucky number (exit code 1; see ") == 2
    assert "learning_rate=0.25,seed=13  0 (unfinished)  -" in printed
    assert "train.learning_rate=0.5     2 seeds         2.5 ± 1.4" in printed
    gathered = json.loads((tmp_path / "runs" / "sweep.json").read_text())
    assert gathered["runs"][0] == {
        "name": "learning_rate=0.25,seed=1",
        "settings": {"train.learning_rate": "0.25", "seed": "1"},
        "finished": True,
        "step": 2,
        "validation": {"loss/huber": 1.25},
    }
    first, _ = gathered["groups"]
    assert (first["settings"], first["runs"]) == ({"train.learning_rate": "0.25"}, 2)
    assert first["mean"] == {"loss/huber": 2.25}
    assert first["standard_deviation"]["loss/huber"] == pytest.approx(2**0.5)


def test_what_is_finished_is_not_trained_again(stub, tmp_path):
    flags = _flags(tmp_path / "runs", "seed=1,2")
    assert sweep.main(flags, stub) == 0
    assert sweep.main(flags, ["/does/not/exist"]) == 0  # the stub would also fail: its folder exists
    assert sweep.main([*flags, "--config.train.learning_rate=1"], stub) == 1  # another config is
