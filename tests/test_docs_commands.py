"""The commands of the pages: each is parsed by the program, and each that is quick is run.

They are run with the debug model and a second of sound, in a folder that has the files that the pages speak of. What is
only parsed, and why, is `PARSED_ONLY`.
"""

import pathlib
import re
import runpy
import shlex
import shutil

import numpy as np
import pytest
import soundfile

from ha2g_jax import cli, launch
from ha2g_jax.checkpoint import model_folder
from ha2g_jax.motion import formats
from ha2g_jax.motion.motion import Motion
from ha2g_jax.skeleton import load_skeleton

ROOT = pathlib.Path(__file__).parent.parent
PAGES = [
    ROOT / "README.md",
    ROOT / "SECURITY.md",
    ROOT / "experiments" / "README.md",
    ROOT / "ha2g_jax" / "assets" / "demo" / "MODEL_CARD.md",
    *sorted((ROOT / "docs").rglob("*.md")),
]
BLOCK = re.compile(r"^```(?:sh|bash|)\n(.*?)^```$", re.DOTALL | re.MULTILINE)

PARSED_ONLY = {
    "train": "compiles for minutes; tests/train runs it",
    "doctor": "compiles and times a step; tests/train/test_doctor.py runs it",
    "evaluate": "takes minutes; tests/test_cli_evaluate.py runs it",
    "data import-": "needs data of others; tests/data runs it",
    "data build-video": "needs videos; tests/data/video runs it",
    "data install-pose": "needs the network and 400 MB",
    "data make-talk": "makes hours of speech; tests/data/talk runs it",
    "data merge": "needs two corpora with different recordings; tests/data/test_merge.py runs it",
    "data inspect": "draws many figures; tests/test_cli_data.py runs it",
}
# Pages whose commands need what the page tells the reader to write; test_extending.py runs them.
OF_THE_READER = {"extending.md"}


def lines_of(page, start):
    """Return the lines of the shell blocks of a page that start with a text, without comments and redirection."""
    blocks = "\n".join(BLOCK.findall(page.read_text())).replace("\\\n", " ")
    lines = re.findall(rf"^{start} (.*)$", blocks, re.MULTILINE)
    return [shlex.split(re.split(r" && | > ", line)[0], comments=True) for line in lines]


def name_of(page):
    return str(page.relative_to(ROOT))


COMMANDS = {name_of(page): lines_of(page, "ha2g") for page in PAGES}
QUICK = {
    page: [command for command in commands if not " ".join(command).startswith(tuple(PARSED_ONLY))]
    for page, commands in COMMANDS.items()
    if pathlib.Path(page).name not in OF_THE_READER
}


def test_commands_are_found():
    """The pages have many commands, and each reason for parsing alone is that of a command."""
    assert sum(map(len, COMMANDS.values())) > 60 and sum(map(len, QUICK.values())) > 25
    every = [" ".join(command) for commands in COMMANDS.values() for command in commands]
    assert all(any(command.startswith(start) for command in every) for start in PARSED_ONLY)


@pytest.mark.parametrize("page", [page for page, commands in COMMANDS.items() if commands])
def test_commands_of_a_page_are_those_of_the_program(page, monkeypatch):
    monkeypatch.chdir(ROOT)
    for command in COMMANDS[page]:
        if command[0] != "train":
            cli._parser().parse_args(command)
        elif pathlib.Path(page).name not in OF_THE_READER:
            text = " ".join(command).replace("train ... ", "train --config talk:paper --workdir runs/talk ")
            launch._parse(["ha2g train", *text.replace(":DATA", ":talk").split()[1:]])


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_commands_in_the_text_exist(page):
    names = {name for name, _ in _parsers(cli._parser(), "ha2g")}
    text = BLOCK.sub("", page.read_text())
    for command in re.findall(r"`(ha2g(?: [a-z][a-z-]+)+)", text):
        assert any(command == name or command.startswith(f"{name} ") for name in names - {"ha2g"}), command


def _parsers(parser, name):
    yield name, parser
    for action in parser._actions:
        if isinstance(action.choices, dict):
            for command, below in action.choices.items():
                yield from _parsers(below, f"{name} {command}")


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_scripts_and_targets_of_a_page_exist(page):
    for script, *arguments in lines_of(page, "python"):
        if script.startswith("experiments/") and page.name not in OF_THE_READER and "launch" not in script:
            runpy.run_path(str(ROOT / script))["_parser"]().parse_known_args(arguments)
        elif page.name not in OF_THE_READER:
            assert (ROOT / script).is_file(), script
    targets = re.findall(r"^(\w[\w-]*):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    assert {target for target, *_ in lines_of(page, "make")} <= set(targets)


@pytest.fixture
def clone(debug_model, tiny_talk, tmp_path, monkeypatch):
    """A folder with the files that the pages speak of, of a second each."""
    skeleton, random = load_skeleton("ted_expressive"), np.random.default_rng(0)
    directions = skeleton.mean_directions + random.normal(0, 0.02, (30, skeleton.num_bones, 3)).astype(np.float32)
    motion = Motion.from_directions(skeleton, directions, 15)
    for name in ("out/demo.npz", "out/mine.npz", "mine.npz", "speech_gestures.npz", "generated.npz"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        motion.save(tmp_path / name)
    formats.export(motion, tmp_path / "captured.bvh")
    for name in ("examples/hello.wav", "speech.wav", "my_speech.wav", "my.wav"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        soundfile.write(tmp_path / name, random.normal(0, 0.1, 16000), 16000)
    (tmp_path / "speech.srt").write_text("1\n00:00:00,200 --> 00:00:00,900\nhello there\n")
    (tmp_path / "runs").mkdir()
    model_folder.save(tmp_path / "runs" / "talk", debug_model.config, debug_model.assets, debug_model.variables)
    shutil.copytree(tmp_path / "runs" / "talk", tmp_path / "runs" / "demo" / "latest")
    shutil.copytree(tiny_talk, tmp_path / "DST")
    monkeypatch.chdir(tmp_path)
    return tmp_path


# At debug size: the model of the package takes half a minute to compile, and a picture of 1080 lines a second to draw.
DEBUG = {"generate": ["--checkpoint", "runs/talk", "--size", "64"], "video": ["--size", "64x64"]}


@pytest.mark.usefixtures("clone")
@pytest.mark.parametrize("page", [page for page, commands in QUICK.items() if commands])
def test_quick_commands_of_a_page_run(page, capsys):
    for command in QUICK[page]:
        flags = DEBUG.get(command[0], [])
        flags = flags if "--checkpoint" not in command else flags[2:]
        assert cli.main([*command, *flags]) == 0, f"{' '.join(command)}: {capsys.readouterr().err}"
