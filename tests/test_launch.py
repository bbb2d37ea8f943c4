"""Flags become a config; what is wrong with them is said in one line, with exit code 2."""

import pathlib
import subprocess
import sys

import pytest

from ha2g_jax import cli, launch
from ha2g_jax.errors import UserError

ROOT = pathlib.Path(__file__).parent.parent
TALK = str(ROOT / "experiments" / "configs" / "talk.py")


def test_a_frame_rate_that_is_no_whole_number_is_named():
    with pytest.raises(UserError, match=r"config.data.fps is 29.97, expected a whole number from 15 to 30"):
        launch.load_config("experiments/configs/talk.py:debug", ["--config.data.fps=29.97"])


def test_a_spec_and_overrides_give_a_locked_config():
    config = launch.load_config(f"{TALK}:small", ["--config.train.batch_size=48", "--config.train.betas=(0.9, 0.99)"])
    assert (config.train.batch_size, config.train.betas) == (48, (0.9, 0.99))
    with pytest.raises(AttributeError):
        config.train.batch_sise = 1
    assert launch.load_config(TALK).train.batch_size == 128  # a second call is not touched by the first


WRONG = {
    "misspelt": (["--config", TALK, "--workdir=x", "--config.train.batch_sise=64"], "batch_size"),
    "no such group": (["--config", TALK, "--workdir=x", "--config.trane.steps=1"], "trane"),
    "not a number": (["--config", TALK, "--workdir=x", "--config.train.steps=many"], "many"),
    "missing file": (["--config=nowhere.py:small", "--workdir=x"], "nowhere.py"),
    "not Python": ([f"--config={ROOT / 'README.md'}", "--workdir=x"], "README.md"),
    "not a config": ([f"--config={__file__}", "--workdir=x"], "get_config"),
    "no such size": (["--config", f"{TALK}:huge", "--workdir=x"], "huge"),
    "unknown flag": (["--config", TALK, "--workdir=x", "--gpu=1"], "--gpu"),
    "no workdir": (["--config", TALK], "--workdir"),
    "no config": (["--workdir=x"], "--config"),
    "extra": (["--config", TALK, "--workdir=x", "small"], "small"),
    "no number": (["--config", TALK, "--workdir=x", "--num_processes=two"], "num_processes"),
    "no coordinator": (["--config", TALK, "--workdir=x", "--num_processes=2", "--process_id=0"], "--coordinator"),
}


@pytest.mark.parametrize(("arguments", "named"), WRONG.values(), ids=WRONG)
def test_what_is_wrong_is_named_in_one_line(arguments, named, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["train", *arguments]) == 2
    printed = capsys.readouterr().err
    assert printed.count("\n") == 1 and named in printed
    assert not list(tmp_path.iterdir())


def test_help(capsys):
    assert cli.main(["train", "--help"]) == 0
    assert "usage: ha2g train --config FILE[:SIZE] --workdir DIR" in capsys.readouterr().out


def test_experiments_launch_takes_the_same_flags(tmp_path):
    command = [sys.executable, str(ROOT / "experiments" / "launch.py"), f"--config={TALK}:debug"]
    command += [f"--workdir={tmp_path / 'run'}", "--config.train.stepz=1"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2 and "steps" in done.stderr and "Traceback" not in done.stderr


@pytest.fixture
def trained(monkeypatch):
    """The arguments with which training was called, and, before them, those of joining the other processes."""
    calls = []
    monkeypatch.setattr("ha2g_jax.train.hosts.start", lambda *place: calls.append(place))
    monkeypatch.setattr("ha2g_jax.train.loop.train", lambda *args, **kwargs: calls.append((*args, kwargs)))
    return calls


def test_both_forms_of_the_flag_reach_training(trained, tmp_path):
    for config in (["--config", f"{TALK}:debug"], [f"--config={TALK}:debug"]):
        assert cli.main(["train", *config, f"--workdir={tmp_path}", "--config.train.steps=7"]) == 0
    for config, workdir, _ in trained[1::2]:
        assert (config.train.steps, workdir) == (7, str(tmp_path))
    assert len(trained) == 4


def test_the_other_flags_reach_training(trained, tmp_path, capsys):
    flags = ["--coordinator=node1:8476", "--num_processes=2", "--process_id", "1", "--profile"]
    assert cli.main(["train", f"--config={TALK}:debug", f"--workdir={tmp_path}", *flags]) == 0
    assert cli.main(["train", f"--config={TALK}:debug", f"--workdir={tmp_path}"]) == 0
    place, (*_, settings), no_place, (*_, defaults) = trained
    assert place == ("node1:8476", 2, 1) and no_place == (None, None, None)
    assert (settings["profile"], defaults["profile"]) == (True, False)
    assert settings["draw_sample"].__name__ == "write_sample"
    assert capsys.readouterr().out == f"{tmp_path}\n" * 2


def test_a_config_without_data_says_so():
    from ha2g_jax.train import inputs

    config = launch.load_config(str(ROOT / "experiments" / "configs" / "ted_gesture.py:debug"))
    with pytest.raises(UserError, match=r"data\.path"):
        inputs.open_corpus(config)
