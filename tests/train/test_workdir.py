"""Two trainings cannot write one workdir, and a training that was killed does not keep the next one out."""

import pathlib

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


def test_a_training_is_refused_before_it_compiles(tiny_talk, tmp_path, monkeypatch):
    monkeypatch.delattr("ha2g_jax.train.sharding.compile_step")
    config = launch.load_config(f"{CONFIG}:debug", [f"--config.data.path={tiny_talk}"])
    with only_run(tmp_path), pytest.raises(UserError, match="another process trains"):
        loop.train(config, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == [LOCK]
