"""The command `ha2g` as a whole: its help says what everything is, and a mistake is shown with the right usage."""

import argparse
import itertools
import json
import os
import pathlib
import re
import signal
import subprocess
import sys
import types

import jax
import numpy as np
import pytest

import ha2g_jax
from ha2g_jax import cli, launch
from ha2g_jax.cli import generate
from ha2g_jax.data.talk.speakers import default_styles
from ha2g_jax.evaluation.speakers import speakers_as_table
from ha2g_jax.files.writing import whole_file
from ha2g_jax.motion.motion import Motion
from ha2g_jax.skeleton import load_skeleton

HELLO = pathlib.Path(__file__).parents[2] / "examples" / "hello.wav"


def parsers(parser, name="ha2g"):
    """Yield the name and the parser of every command, and the entries of help of its subcommands."""
    yield name, parser
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            assert {choice.dest for choice in action._choices_actions} == set(action.choices), name
            assert all(choice.help for choice in action._choices_actions), name
            for command, below in action.choices.items():
                yield from parsers(below, f"{name} {command}")


COMMANDS = dict(parsers(cli.make_parser()))
READERS = pathlib.Path(ha2g_jax.__file__).parent / "motion" / "readers"


@pytest.mark.parametrize("path", sorted(READERS.glob("*.py")), ids=lambda path: path.stem)
def test_a_message_of_a_reader_names_no_option_that_a_command_lacks(path):
    """Recordings with sound and words are read by the import alone, all else by every command that has a joint map."""
    named = set(re.findall(r"--[a-z][a-z-]*", path.read_text()))
    options = {name: {*command._option_string_actions} for name, command in COMMANDS.items()}
    reading = {name for name, own in options.items() if "--joint-map" in own}
    for name in {"ha2g data import"} if path.stem == "recordings" else reading:
        assert named <= options[name], name
    assert len(reading) == 6


def test_an_option_of_reading_that_has_no_effect_is_refused(tmp_path, capsys):
    """Of several files one is enough that has a unit or a rate; motion of ours has none to state."""
    skeleton = load_skeleton("ted_expressive")
    motion = Motion.from_directions(skeleton, skeleton.mean_directions[None], 15)
    motion.save(tmp_path / "own.npz")
    np.save(tmp_path / "bare.npy", motion.directions)
    np.save(tmp_path / "places.npy", 100 * motion.positions)

    def shown(*names: str, **options: float) -> int:
        given = [text for name, value in options.items() for text in (f"--{name.replace('_', '-')}", str(value))]
        return cli.main(["view", *(str(tmp_path / name) for name in names), *given, "-o", str(tmp_path / "x.html")])

    assert shown("own.npz", "places.npy", unit=0.01) == shown("own.npz", "bare.npy", source_fps=24) == 0
    assert shown("own.npz", "bare.npy", unit=0.01) == shown("own.npz", source_fps=24) == 2
    assert "own.npz and the others does not depend on --unit; leave --unit out" in capsys.readouterr().err
    assert shown("places.npy", unit=1) == 2
    assert "it has arms" in capsys.readouterr().err
    own = str(tmp_path / "own.npz")
    assert cli.main(["evaluate", "--motion", own, "--speech", "x.wav", "--source-fps", "60"]) == 2
    assert "own.npz does not depend on --source-fps" in capsys.readouterr().err


def test_a_device_without_memory_is_one_line(monkeypatch, capsys):
    def fail(argv):
        raise jax.errors.JaxRuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating 7 bytes.")

    monkeypatch.setattr(launch, "main", fail)
    assert cli.main(["train"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.parametrize("name", COMMANDS)
def test_every_argument_says_what_it_is(name):
    for action in COMMANDS[name]._actions:
        if not isinstance(action, argparse._SubParsersAction):
            assert action.help and action.help != argparse.SUPPRESS, f"{name} {action.option_strings or action.dest}"
    assert COMMANDS[name].format_help()  # a stray % in a help text would fail here


def test_an_unknown_flag_is_answered_with_the_usage_of_its_command(capsys):
    with pytest.raises(SystemExit) as stop:
        cli.main(["data", "split", "a", "b", "--nope", "3"])
    printed = capsys.readouterr().err
    assert stop.value.code == 2 and printed.startswith("usage: ha2g data split ")
    assert re.search(r"ha2g data split: error: unknown arguments: --nope.*; see ha2g data split --help\n$", printed)


@pytest.mark.parametrize("argv", [["generate", "-talk.wav"], ["generate", "a.wav", "--pin", "-talk.wav"]])
def test_a_value_that_looks_like_an_option_is_named(argv, capsys):
    with pytest.raises(SystemExit):
        cli.main(argv)
    assert capsys.readouterr().err.endswith(
        "-talk.wav begins with a dash: write ./-talk.wav for a file, or --OPTION=-talk.wav\n"
    )


@pytest.mark.parametrize(
    ("argv", "end"),
    [
        (["generate", "--hlep"], "required: SPEECH\n"),
        (["generate", "-oout.mp4"], "required: SPEECH\n"),
        (["live", "--look-ahead", "-1"], "required: --source, --sink\n"),
    ],
)
def test_what_is_missing_is_not_taken_for_a_value_with_a_dash(argv, end, capsys):
    with pytest.raises(SystemExit):
        cli.main(argv)
    assert capsys.readouterr().err.endswith(end)


def test_version(capsys):
    with pytest.raises(SystemExit) as stop:
        cli.main(["--version"])
    assert stop.value.code == 0 and capsys.readouterr().out == f"ha2g {ha2g_jax.__version__}\n"


def test_speakers_of_the_demo_are_those_of_talk(capsys):
    assert cli.main(["speakers", "--json"]) == 0
    rows = {row["name"]: row for row in json.loads(capsys.readouterr().out)}
    styles = default_styles()
    assert list(rows) == list(styles)[:40]
    assert rows["speaker-00"]["in_words"] == "right-handed, large, mostly beats, arms wide, early"
    assert rows["speaker-00"]["hand"] == ("right" if styles["speaker-00"].handedness > 0 else "left")
    assert rows["speaker-03"]["amplitude"] == pytest.approx(styles["speaker-03"].amplitude, abs=0.006)
    assert cli.main(["speakers"]) == 0
    text = capsys.readouterr().out
    assert text.startswith("name        hand ") and "handedness  which hand does more" in text


def test_speakers_of_another_model_have_names_only(debug_folder, capsys):
    """The debug model has no data path, so that nothing is known of its speakers."""
    assert cli.main(["speakers", "--checkpoint", str(debug_folder), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == [{"name": "ada"}, {"name": "ben"}]
    assert cli.main(["speakers", "--checkpoint", str(debug_folder)]) == 0
    assert "nothing about how they move" in capsys.readouterr().out


def test_names_of_speakers_are_shown_as_printable_text():
    """A model of another person may have any names."""
    text = speakers_as_table([{"name": "\x1b[31mred"}, {"name": "a\nb"}, {"name": "x" * 5000}])
    lines = text.splitlines()[:4]
    assert [line[:9] for line in lines] == ["name", "\\x1b[31mr", "a\\nb", "x" * 9]
    assert len(lines[3]) < 210


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGHUP, 129)])
def test_a_signal_leaves_nothing_half_written(tmp_path, monkeypatch, number, code):
    """It ends a command with the exit code of a shell, and the handling of the process is as before."""

    def end(arguments):
        with whole_file(tmp_path / "a.npz") as temporary:
            temporary.write_bytes(b"half")
            signal.raise_signal(number)
            pytest.fail("the command went on")

    monkeypatch.setattr(generate, "_list_speakers", end)
    before = signal.signal(number, signal.SIG_DFL)
    try:
        with pytest.raises(SystemExit) as stop:
            cli.main(["speakers"])
        assert stop.value.code == code and signal.getsignal(number) == signal.SIG_DFL
    finally:
        signal.signal(number, before)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("out", ["-", os.devnull])
@pytest.mark.parametrize(
    "command", ["generate a.wav", "export a.npz", "export --format bvh a.npz", "genea pack talks", "study analyse a"]
)
def test_nothing_is_written_to_a_pipe_or_device(tmp_path, monkeypatch, capsys, command, out):
    monkeypatch.chdir(tmp_path)
    study = ["--study", "b"] if command.startswith("study") else []
    assert cli.main([*command.split(), *study, "-o", out]) == 2
    expected = f"ha2g: cannot write to {out}; give the path of a file or folder, not of a pipe or a device\n"
    assert capsys.readouterr().err == expected


def test_an_interrupt_while_a_command_is_imported(monkeypatch, capsys):
    def interrupt(name, *_):
        if name == "ha2g_jax.cli.live":
            raise KeyboardInterrupt

    monkeypatch.delitem(sys.modules, "ha2g_jax.cli.live")
    monkeypatch.delattr(cli, "live")
    monkeypatch.setattr(sys, "meta_path", [types.SimpleNamespace(find_spec=interrupt), *sys.meta_path])
    assert cli.main(["--version"]) == 130
    assert capsys.readouterr().err == "ha2g: interrupted\n"


@pytest.mark.parametrize(("old", "new"), cli.ALIASES.items())
def test_an_earlier_name_of_a_command_still_works_and_is_not_in_the_help(old, new):
    assert cli.current_names([*old, "a", "--out", "b"]) == [*new, "a", "--out", "b"]
    assert f"ha2g {' '.join(old)}" not in COMMANDS
    words = itertools.takewhile(lambda word: not word.startswith("-"), new)
    assert " ".join(["ha2g", *words]) in COMMANDS


def test_the_help_lists_every_command_once():
    names = [name for group in cli.GROUPS.values() for name in group]
    assert sorted(names) == sorted({name.split()[1] for name in COMMANDS if " " in name})
    assert re.findall(r"^  (\w+) ", cli.make_parser().format_help(), re.MULTILINE) == names


@pytest.mark.parametrize(("platforms", "code"), [("cuda", 2), ("", 0)])
def test_a_platform_or_a_plugin_that_does_not_start_is_one_line(tmp_path, platforms, code):
    plugin = tmp_path / "jax_plugins" / "xla_cuda12" / "__init__.py"
    plugin.parent.mkdir(parents=True)
    plugin.write_text("def initialize():\n    raise RuntimeError('jax_cuda12_plugin is of version 0.4.30')\n")
    command = [sys.executable, "-m", "ha2g_jax.cli", "doctor", "--describe"]
    environment = os.environ | {"JAX_PLATFORMS": platforms, "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    assert (done.returncode, "Traceback" in done.stderr) == (code, False), done.stderr
    assert ("JAX has no platform" in done.stderr) == (code == 2)
    assert "(jax_cuda12_plugin is of version 0.4.30): install JAX and its plugin in one version" in done.stderr
    assert "pip install -U 'jax[cuda12]'" in done.stderr
