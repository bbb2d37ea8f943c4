"""The commands of the pages: each is parsed by the program, and all but `PARSED_ONLY` are run.

They are run at debug size by the rules of `DEBUG`, in a folder that has the files that the pages speak of, of a few
seconds each.
"""

import functools
import pathlib
import re
import runpy
import shlex
import shutil

import jax
import numpy as np
import pytest
import soundfile
from fixtures.corpora import make_clip, write_corpus
from fixtures.workdirs import write_run

from ha2g_jax import cli, launch
from ha2g_jax.checkpoint import model_folder
from ha2g_jax.checkpoint.assets import Assets
from ha2g_jax.config import presets
from ha2g_jax.data.corpus import TALK_VERSION
from ha2g_jax.evaluation import scoring, talk_takes
from ha2g_jax.evaluation.evaluate import evaluate
from ha2g_jax.features.text import Vocabulary
from ha2g_jax.motion import formats
from ha2g_jax.motion.motion import Motion
from ha2g_jax.skeleton import load_skeleton
from ha2g_jax.train.objective import build_objective

ROOT = pathlib.Path(__file__).parent.parent
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    ROOT / "SECURITY.md",
    ROOT / "benchmarks" / "README.md",
    ROOT / "experiments" / "README.md",
    ROOT / "integrations" / "web" / "README.md",
    ROOT / "ha2g_jax" / "assets" / "demo" / "MODEL_CARD.md",
    *sorted((ROOT / "docs").rglob("*.md")),
]
BLOCK = re.compile(r"^```(?:sh|bash|)\n(.*?)^```$", re.DOTALL | re.MULTILINE)

PARSED_ONLY = {
    "train": "tests/train and test_baselines.py train",
    "doctor": "tests/train/test_doctor.py and tests/evaluation/test_benchmark.py run it",
    "data import": "tests/importers import files in the layouts of all collections",
    "data build-video": "needs the environment of the pose estimator; tests/importers/video runs it",
    "model import": "needs released weights; tests/checkpoint/released imports some",
    "generate speech.wav --words speech.srt --checkpoint models/released": "needs released weights",
    "generate speech.wav --checkpoint hf://": "needs a model on the Hub; tests/checkpoint/test_hub.py fetches one",
    "model publish": "needs a token of the Hub; tests/checkpoint/test_hub.py publishes",
    "live --source microphone": "needs a microphone",
    "live --source ws": "runs until Ctrl-C; tests/apps/live runs it",
    "serve": "runs until it is stopped; tests/apps/serve runs it",
    "study analyse": "needs the answers of participants; tests/apps/user_study analyses some",
    "study power mismatch": "needs such answers as well",
    "web": "needs node, and npm with its registry; tests/apps/web runs it",
}
# Of the recipes and the demo the corpora are those of others, and the scores those of other pages.
PARSED_PAGES = {"docs/recipes.md", "ha2g_jax/assets/demo/MODEL_CARD.md", "docs/results/README.md", "docs/table1.md"}
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
# What makes a command one of debug size: patterns of its text, which are replaced in this order.
DEBUG = (
    (r"\bCORPUS\b", "talk"),
    (r"^data make-talk .*", r"\g<0> --speakers 2 --minutes 1.2"),  # of two equal flags the last holds
    (r" --synthesiser flite", ""),  # a library of the system
    (r" /shared/", " shared/"),
    (r"^data inspect (?!.*--check).* (-o|--out) .*", r"\g<0> --samples 1"),
    (r"^generate (?!.*--checkpoint).*", r"\g<0> --checkpoint runs/talk"),  # the demo takes half a minute to compile
    (r"^model average .*", "model average runs/talk runs/talk -o average"),
    (
        r"^generate (?!.*(?:-o|--out|--format) \S*(?:bvh|glb|vrma|json|csv|npz|html|fbx)\b).*",
        r"\g<0> --size 64",  # a picture of 1080 lines takes a second to draw
    ),
    (r"^study make .*", r"\g<0> --size 64"),
    (r"\.fbx\b", ".glb"),  # of which Blender writes the other
    (r"^export .*\.mp4.*", r"\g<0> --size 64x64"),
    (r"^live (?!.*--checkpoint)(.*?)(?: --fast)?$", r"live \1 --checkpoint runs/talk --fast"),
)


def debug_size(command):
    """Return a command by the rules of `DEBUG`."""
    text = shlex.join(command)
    for pattern, replacement in DEBUG:
        text = re.sub(pattern, replacement, text)
    return shlex.split(text)


def commands_to_run():
    """Return the commands of each page at debug size, without those that an earlier page has as well."""
    found, seen = {}, []
    for page, commands in COMMANDS.items():
        found[page] = []
        for command in commands:
            made = debug_size(command)
            if pathlib.Path(page).name in OF_THE_READER or shlex.join(command).startswith(tuple(PARSED_ONLY)):
                continue
            if made not in seen and page not in PARSED_PAGES:
                seen.append(made)
                found[page].append(made)
    return found


RUN = commands_to_run()


def test_commands_are_found():
    """The pages have many commands, and each reason for parsing alone is that of a command."""
    assert sum(map(len, COMMANDS.values())) > 60 and sum(map(len, RUN.values())) > 50
    every = [" ".join(command) for commands in COMMANDS.values() for command in commands]
    assert all(any(command.startswith(start) for command in every) for start in PARSED_ONLY)


@pytest.mark.parametrize("page", [page for page, commands in COMMANDS.items() if commands])
def test_commands_of_a_page_are_those_of_the_program(page, monkeypatch):
    monkeypatch.chdir(ROOT)
    for command in COMMANDS[page]:
        if command[0] != "train":
            cli.make_parser().parse_args(cli.current_names(command))
        elif pathlib.Path(page).name not in OF_THE_READER:
            text = " ".join(command).replace("train ... ", "train --config talk:paper --workdir runs/talk ")
            launch._parse(["ha2g train", *text.replace(":DATA", ":talk").split()[1:]])


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_commands_in_the_text_exist(page):
    names = {name for name, _ in _parsers(cli.make_parser(), "ha2g")}
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
        elif page.name not in OF_THE_READER and not script.startswith("-"):
            assert (ROOT / script).is_file(), script
    targets = re.findall(r"^(\w[\w-]*):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    assert {target for target, *_ in lines_of(page, "make")} <= set(targets)


SECONDS = 4  # of motion and sound; an import leaves out what is shorter than 2.8
NAMES = ("one", "two")
MOTIONS = (
    *("out/demo.npz", "out/mine.npz", "mine.npz", "true.npz", "speech_gestures.npz", "generated.npz"),
    *(f"{folder}/{name}.npz" for folder in ("my_system", "MINE", "THEIRS", "TRUE") for name in NAMES),
)
CAPTURED = ("captured.bvh", "SPEAKER.bvh")
SOUNDS = {"my.wav": 12, "test_speech/2_scott_0_1_1.wav": 8} | dict.fromkeys(  # a recording is scored from 10 seconds on
    ("examples/hello.wav", "speech.wav", "my_speech.wav", *(f"TRUE/{name}.wav" for name in NAMES)), SECONDS
)


@pytest.fixture(scope="module")
def files(debug_model, draw_state, tiny_talk, tmp_path_factory):
    """A folder with the files that the pages speak of."""
    folder = tmp_path_factory.mktemp("files")
    for path in (*MOTIONS, *SOUNDS, "runs/talk", "corpora/video"):
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
    for seed, name in enumerate(MOTIONS):
        swaying(seed).save(folder / name)
    for seed, name in enumerate(CAPTURED):
        formats.export(swaying(seed), folder / name)
    for name, seconds in SOUNDS.items():
        write_speech(folder / name, seconds)
    (folder / "consent.txt").write_text("I take part.\n")
    write_smplx(folder)
    for name in ("DST", "corpora/mocap", "corpora/video", TALK_VERSION):
        (folder / name).symlink_to(tiny_talk)
    for name in ("ONE", "TWO"):
        write_corpus(folder / name, {"train": [make_clip(f"clip of {name}", speaker="ada")]})
    model_folder.save(folder / "runs" / "talk", debug_model.config, debug_model.assets, debug_model.variables)
    shutil.copytree(folder / "runs" / "talk", folder / "runs" / "demo" / "best")
    write_autoencoder(folder / "runs" / "autoencoder", draw_state)
    for seed in (0, 1):
        write_run(folder / "runs" / "sweep" / f"seed={seed}", seed=seed)
    return folder


def swaying(seed):
    """Return a motion of waves about the mean pose, without a pause."""
    skeleton, random = load_skeleton("ted_expressive"), np.random.default_rng(seed)
    frames = np.arange(15 * SECONDS)[:, None, None]
    waves = np.sin(frames * random.uniform(0.2, 0.6, (1, skeleton.num_bones, 3))).astype(np.float32)
    return Motion.from_directions(skeleton, skeleton.mean_directions + 0.2 * waves, 15)


def write_speech(path, seconds):
    """Write noise as sound and, beside it, two words each second."""
    soundfile.write(path, np.random.default_rng(0).normal(0, 0.1, 16000 * seconds), 16000)
    cues = [f"{number}\n00:00:{number:02},000 --> 00:00:{number:02},800\nboth hands\n" for number in range(seconds)]
    path.with_suffix(".srt").write_text("\n".join(cues))


def write_smplx(folder):
    """Write poses as in BEAT2."""
    poses = np.zeros((30 * 2 * SECONDS, 55, 3))
    poses[:, 16:18, 2] = [-1, 1]  # arms down
    poses[:, 18:20, 1] = np.sin(np.arange(len(poses)) / 10)[:, None] * [0.8, -0.8]  # the elbows swing
    arrays = {"poses": poses.reshape(-1, 165), "trans": np.zeros((len(poses), 3)), "betas": np.zeros(300)}
    names = [f"{place}/2_scott_0_1_1.npz" for place in ("smplxflame_30", "MOTIONS")]
    for name in (*names, "poses.npz", *(f"smplx/{system}/one.npz" for system in ("emage", "ours", "true"))):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        np.savez(folder / name, mocap_frame_rate=30, gender="neutral", **arrays)
    np.save(folder / "directions.npy", swaying(0).directions)


def write_autoencoder(folder, draw_state):
    """Write a pose auto-encoder with random weights."""
    skeleton, config = load_skeleton("ted_expressive"), presets.parse("talk:debug", "autoencoder")
    variables = jax.device_get(draw_state(build_objective(config, skeleton, 0, 0)).model)
    starts = skeleton.mean_directions[None, None].repeat(config.data.num_seed_frames, axis=1)
    model_folder.save(folder, config, Assets(skeleton, Vocabulary(()), {}, starts), variables)


@pytest.fixture
def clone(files, tmp_path, monkeypatch):
    """A copy of `files` as the working folder, where little is compiled and `talk` is the tiny corpus."""
    shutil.copytree(files, tmp_path, symlinks=True, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HA2G_CACHE", str(tmp_path))
    monkeypatch.setattr("os.cpu_count", lambda: 1)  # processes start slowly
    monkeypatch.setattr(scoring, "evaluate", functools.partial(evaluate, draws=10))  # 1000 take up to half a minute
    monkeypatch.setattr(talk_takes, "MAX_CLIPS", 1)


@pytest.mark.usefixtures("clone")
@pytest.mark.parametrize("page", [page for page, commands in RUN.items() if commands])
def test_commands_of_a_page_run(page, capsys):
    for command in RUN[page]:
        assert cli.main(command) == 0, f"{shlex.join(command)}: {capsys.readouterr().err}"
