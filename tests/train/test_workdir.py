"""Two trainings cannot write one workdir, and a training that was killed does not keep the next one out."""

import pathlib
import signal
import subprocess
import sys

import pytest

from ha2g_jax import launch
from ha2g_jax.errors import UserError
from ha2g_jax.train import loop
from ha2g_jax.train.workdir import LOCK, is_training, only_run

CONFIG = pathlib.Path(__file__).parent.parent / "one_stage.py"


def test_a_second_training_is_refused_until_the_first_ends(tmp_path):
    workdir = tmp_path / "runs" / "talk"
    with only_run(workdir):
        assert is_training(workdir)
        with pytest.raises(UserError, match=r"another process trains in .*talk: wait"), only_run(workdir):
            pass
    assert not is_training(workdir)
    with only_run(workdir):
        assert [path.name for path in workdir.iterdir()] == [LOCK]


def test_a_killed_training_leaves_no_lock(tmp_path):
    code = (
        "import pathlib, sys, time\nfrom ha2g_jax.train.workdir import only_run\n"
        "with only_run(pathlib.Path(sys.argv[1])):\n    print('held', flush=True)\n    time.sleep(600)"
    )
    process = subprocess.Popen([sys.executable, "-c", code, tmp_path], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        assert process.stdout.readline() == "held\n"
        with pytest.raises(UserError, match="another process trains"), only_run(tmp_path):
            pass
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait()
        process.stdout.close()
    with only_run(tmp_path):
        pass


def test_a_training_is_refused_before_it_compiles(tiny_talk, tmp_path, monkeypatch):
    monkeypatch.delattr("ha2g_jax.train.sharding.compile_step")
    config = launch.load_config(f"{CONFIG}:debug", [f"--config.data.path={tiny_talk}"])
    with only_run(tmp_path), pytest.raises(UserError, match="another process trains"):
        loop.train(config, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == [LOCK]


def test_a_workdir_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / "file").touch()
    with (
        pytest.raises(UserError, match=r"cannot write .*run \(not a directory\)"),
        only_run(tmp_path / "file" / "run"),
    ):
        pass
