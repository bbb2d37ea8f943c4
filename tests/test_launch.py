"""Flags become a config; what is wrong with them is said in one line, with exit code 2."""

import pathlib

import pytest

from ha2g_jax import cli, launch
from ha2g_jax.config import presets
from ha2g_jax.errors import UserError

ROOT = pathlib.Path(__file__).parent.parent
TALK = str(ROOT / "experiments" / "configs" / "talk.py")


def test_a_spec_and_overrides_give_a_locked_config():
    config = launch.load_config(f"{TALK}:small", ["--config.train.batch_size=48", "--config.train.betas=(0.9, 0.99)"])
    assert (config.train.batch_size, config.train.betas) == (48, (0.9, 0.99))
    with pytest.raises(AttributeError):
        config.train.batch_sise = 1
    assert launch.load_config(TALK).train.batch_size == 128  # a second call is not touched by the first


@pytest.mark.parametrize(
    ("name", "preset"),
    [
        ("talk", ("talk", "", "ha2g")),
        ("talk:small", ("talk", "small", "ha2g")),
        ("trimodal", ("talk", "", "trimodal")),
        ("autoencoder:ted_gesture:small", ("ted_gesture", "small", "autoencoder")),
        (f"{TALK}:small", ("talk", "small", "ha2g")),
    ],
)
def test_a_name_or_the_example_file_is_a_preset(name, preset):
    assert launch.load_config(name).to_json() == presets.make(*preset).to_json()


def test_a_file_with_the_name_of_a_preset_is_executed_only_as_a_path(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    pathlib.Path("talk").write_text("raise SystemExit('executed')")
    assert launch.load_config("talk:debug").train.steps == 2
    with pytest.raises(UserError, match="executed"):
        launch.load_config("./talk")


def test_a_config_that_fails_is_named_with_its_line(tmp_path):
    path = tmp_path / "mine.py"
    path.write_text("def get_config(size):\n    return 1 / 0\n")
    with pytest.raises(UserError, match=r"mine.py failed in line 2 with ZeroDivisionError: division by zero"):
        launch.load_config(f"{path}:small")
    path.write_bytes(b"\0\xff binary")
    with pytest.raises(UserError, match=r"mine.py failed with \w+Error"):
        launch.load_config(str(path))


WRONG = {
    "misspelt": (["--config", TALK, "--workdir=x", "--config.train.batch_sise=64"], "batch_size"),
    "not a number": (["--config", TALK, "--workdir=x", "--config.train.steps=many"], "many"),
    "no such preset": (["--config=walk:small", "--workdir=x"], "talk:small"),
    "not a config": ([f"--config={__file__}", "--workdir=x"], "get_config"),
    "unknown flag": (["--config", TALK, "--workdir=x", "--gpu=1"], "--gpu"),
    "no workdir": (["--config", TALK], "--workdir"),
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
    text = capsys.readouterr().out
    assert all(name in text for name in (*presets.DATA, *presets.METHODS, "FILE[:SIZE]", "--workdir DIR"))
    assert text.startswith("usage: ha2g train --config CONFIG --workdir DIR")


@pytest.fixture
def trained(monkeypatch):
    """The arguments with which training was called, and, before them, those of joining the other processes."""
    calls = []
    monkeypatch.setattr("ha2g_jax.train.hosts.start", lambda *place: calls.append(place))
    monkeypatch.setattr("ha2g_jax.data.talk.build.make_talk", lambda *_: None)
    monkeypatch.setattr("ha2g_jax.train.loop.train", lambda *args, **kwargs: calls.append((*args, kwargs)))
    return calls


def test_the_other_flags_reach_training(trained, tmp_path, capsys):
    flags = ["--coordinator=node1:8476", "--num_processes=2", "--process_id", "1", "--profile"]
    assert cli.main(["train", f"--config={TALK}:debug", f"--workdir={tmp_path}", *flags]) == 0
    assert cli.main(["train", f"--config={TALK}:debug", f"--workdir={tmp_path}"]) == 0
    place, (*_, settings), no_place, (*_, defaults) = trained
    assert place == ("node1:8476", 2, 1) and no_place == (None, None, None)
    assert (settings["profile"], defaults["profile"]) == (True, False)
    assert settings["draw_sample"].__name__ == "write_sample"
    assert capsys.readouterr().out == f"{tmp_path}\n" * 2
