"""The commands of the pages: each is parsed by the program, and all but `PARSED_ONLY` are run.

They are run at debug size by the rules of `DEBUG`, in a folder that has the files that the pages speak of, of a few
seconds each. There a step of training changes no network; tests/train and test_baselines.py test the steps.
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
from fixtures.simulated_study import write_study
from fixtures.workdirs import write_run

from ha2g_jax import cli, launch
from ha2g_jax.checkpoint import model_folder
from ha2g_jax.checkpoint.assets import Assets
from ha2g_jax.config import presets
from ha2g_jax.evaluation import scoring
from ha2g_jax.evaluation.evaluate import evaluate
from ha2g_jax.features.text import Vocabulary
from ha2g_jax.motion import formats
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.readers.smplx_body import template
from ha2g_jax.skeleton import load_skeleton
from ha2g_jax.train import loop, sharding
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
    "data build-video": "needs the environment of the pose estimator; tests/importers/video runs it",
    "model import": "needs released weights; tests/checkpoint/released imports some",
    "generate speech.wav --words speech.srt --checkpoint models/released": "needs released weights",
    "generate speech.wav --checkpoint hf://": "needs a model on the Hub; tests/checkpoint/test_hub.py fetches one",
    "model publish": "needs a token of the Hub; tests/checkpoint/test_hub.py publishes",
    "live --source microphone": "needs a microphone",
    "live --source ws": "runs until Ctrl-C; tests/apps/live runs it",
    "serve": "runs until it is stopped; tests/apps/serve runs it",
    "web": "needs node, and npm with its registry; tests/apps/web runs it",
}
# Of the recipes the imports and what is done with the corpora run; training and scores are those of other pages.
RECIPES = "docs/recipes.md"
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
    (r"^train \.\.\. ", "train --config talk --workdir runs/talk "),
    (r":DATA\b", ":talk"),
    (r"\bCORPUS\b", "talk"),
    (r"\bSRC\b", "recordings"),
    (r"(^train .*--config\.data\.path=)corpora/(?!talk30)\S+", r"\1talk"),
    (r"^((train|doctor) --config \S*talk)\S*", r"\1:debug"),
    (r"^doctor --config \S+ --gradients", "doctor --config seq2seq:talk:debug --gradients"),  # its terms compile sooner
    (r"^doctor --config \S+ --(describe|benchmark).*", r"doctor --config talk:debug --\1"),
    (r"--benchmark", r"--benchmark --precision float32 --batch-size 2 --steps 1 --checkpoint runs/talk"),
    (r"^(train --config bvh:)medium( .*init_from=)", r"\1debug\2"),
    (r" (--config\.train\.init_from=)demo", r" \1runs/talk"),
    (r" --config\.train\.(steps|devices|batch_size)=\d+", ""),  # the debug size has its own
    (r"^(train .*--workdir) \S+", r"\1 trained"),
    (r"^data make-talk .*", r"\g<0> --speakers 2 --minutes 1.2"),  # of two equal flags the last holds
    (r" --synthesiser flite", ""),  # a library of the system
    (r" /shared/", " shared/"),
    (r"^data inspect (?!.*--check).* (-o|--out) .*", r"\g<0> --samples 1"),
    (r"^generate (?!.*--checkpoint).*", r"\g<0> --checkpoint runs/talk"),  # the demo takes half a minute to compile
    (r"^model average .*", "model average runs/talk runs/talk -o average"),
    (r"^generate .*", r"\g<0> --size 64"),  # a picture of 1080 lines takes a second to draw
    (r"^study make .*", r"\g<0> --size 64"),
    (r"^export .*\.mp4.*", r"\g<0> --size 64x64"),
    (r"^study power .*", r"\g<0> --simulations 20"),
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
            if page == RECIPES and command[0] != "data":
                continue
            if pathlib.Path(page).name in OF_THE_READER or shlex.join(command).startswith(tuple(PARSED_ONLY)):
                continue
            if made not in seen:
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
    *("out/demo.npz", "out/mine.npz", "mine.npz", "speech_gestures.npz", "generated.npz"),
    *(f"{folder}/{name}.npz" for folder in ("my_system", "MINE", "THEIRS", "TRUE") for name in NAMES),
)
PEOPLE = ("one", "two", "three")  # as many recordings as there are splits
OF_RECIPES = tuple(f"{folder}/{name}" for folder in ("zeroeggs/clean", "twh") for name in PEOPLE)
CAPTURED = (
    *("captured.bvh", "SPEAKER.bvh", "take.bvh"),
    *(f"recordings/{name}.bvh" for name in PEOPLE),
    *(f"{name}.bvh" for name in OF_RECIPES),
)
SOUNDS = {"my.wav": 12, "test_speech/2_scott_0_1_1.wav": 8} | dict.fromkeys(  # a recording is scored from 10 seconds on
    (
        *("examples/hello.wav", "speech.wav", "my_speech.wav", "take_mic.wav"),
        *(f"recordings/{name}.wav" for name in PEOPLE),
        *(f"TRUE/{name}.wav" for name in NAMES),
        *(f"{name}.wav" for name in OF_RECIPES),
    ),
    SECONDS,
)


@pytest.fixture(scope="module")
def files(debug_model, draw_state, tiny_talk, tmp_path_factory):
    """A folder with the files that the pages speak of."""
    folder = tmp_path_factory.mktemp("files")
    for path in (*MOTIONS, *CAPTURED, *SOUNDS, "runs/talk", "corpora/video", "ted_dataset/train"):
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
    for seed, name in enumerate(MOTIONS):
        swaying(seed).save(folder / name)
    for seed, name in enumerate(CAPTURED):
        formats.export(swaying(seed), folder / name)
    for name, seconds in SOUNDS.items():
        write_speech(folder / name, seconds)
    shutil.copy(folder / "speech.srt", folder / "take.srt")
    shutil.copy(ROOT / "ha2g_jax" / "assets" / "joint_maps" / "ha2g.json", folder / "my_joints.json")
    (folder / "consent.txt").write_text("I take part.\n")
    write_study(folder / "my_study")
    write_smplx(folder)
    write_ted(folder / "ted_dataset")
    write_recipes(folder)
    write_corpora(folder, tiny_talk)
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


def functions_of(test):
    """Return the functions of a test of data, which write files in formats of others."""
    return runpy.run_path(str(ROOT / "tests" / test))


def write_smplx(folder):
    """Write poses as in BEAT2, poses with a body model, and positions as ExPose gives them."""
    write, beat = functions_of("importers/test_import_smplx.py"), folder / "beat2"
    write["_motion"](beat / "smplxflame_30" / "2_scott_0_1_1.npz")
    write["_speech"](beat / "wave16k" / "2_scott_0_1_1.wav", beat / "textgrid" / "2_scott_0_1_1.TextGrid")
    write["_motion"](folder / "poses.npz")
    for place in ("smplxflame_30", "MOTIONS"):
        write["_motion"](folder / place / "2_scott_0_1_1.npz")
    np.save(folder / "directions.npy", swaying(0).directions)
    for system in ("emage", "ours", "true"):
        write["_motion"](folder / "smplx" / system / "one.npz")
    write["_speech"](folder / "poses.wav", folder / "poses.TextGrid")
    model = functions_of("motion/readers/test_smplx_body.py")["_model"]()
    np.savez(folder / "SMPLX_NEUTRAL.npz", allow_pickle=True, **model)
    joints = template().points[:55]
    waves = np.sin(np.arange(25 * SECONDS) / 5)[:, None, None] * np.random.default_rng(0).normal(0, 0.1, joints.shape)
    np.save(folder / "expose_joints.npy", joints + waves)


def write_ted(folder):
    """Write a video in each split of TED-Expressive."""
    write = functions_of("importers/ted/conftest.py")
    for split in ("train", "val", "test"):
        (folder / split).mkdir()
        write["_write_database"](folder / split, [write["_make_video"](f"video of {split}", joints=43)])


def write_recipes(folder):
    """Write files in the layouts of the collections that the recipes speak of, beside those of `CAPTURED`."""
    beat, root = functions_of("importers/test_import_smplx.py"), folder / "BEAT2" / "beat_english_v2.0.0"
    for number, name in enumerate(PEOPLE, start=1):
        stem = f"{number}_{name}_0_1_1"
        beat["_motion"](root / "smplxflame_30" / f"{stem}.npz")
        beat["_speech"](root / "wave16k" / f"{stem}.wav", root / "textgrid" / f"{stem}.TextGrid")
    layouts = functions_of("motion/readers/test_published_layouts.py")
    poses = np.zeros((layouts["FRAMES"], 55, 3))
    poses[:, 18:20, 1] = np.sin(np.arange(len(poses)) / 10)[:, None] * [0.8, -0.8] + [-1, 1]  # the elbows swing
    for number, split in enumerate(("dev", "train")):
        name = f"V00_S0809_I00000582_P{number}"
        layouts["write_seamless"](folder / "seamless_interaction" / "improvised" / split / "0000", poses, name)
    layouts["write_embody"](folder / "datasets" / "emotions", poses, people=PEOPLE, silent=())
    write = functions_of("importers/ted/conftest.py")
    for name, joints, prefix in (("ted_expressive_dataset", 43, ""), ("ted_gesture_dataset", 10, "lmdb_")):
        for split in ("train", "val", "test"):
            place = folder / "data" / name / f"{prefix}{split}"
            place.mkdir(parents=True)
            write["_write_database"](place, [write["_make_video"](f"video of {split}", joints=joints)])


def write_corpora(folder, tiny_talk):
    """Write the corpora that the pages merge; all others are the tiny one, the Talk corpus of the cache included."""
    for name in ("DST", "corpora/video", "corpora/own_all", "talk-v3"):
        (folder / name).symlink_to(tiny_talk)
    for name in ("ONE", "TWO"):
        write_corpus(folder / name, {"train": [make_clip(f"clip of {name}", speaker="ada")]})


def write_autoencoder(folder, draw_state):
    """Write a pose auto-encoder with random weights."""
    skeleton, config = load_skeleton("ted_expressive"), presets.parse("talk:debug", "autoencoder")
    variables = jax.device_get(draw_state(build_objective(config, skeleton, 0, 0)).model)
    starts = skeleton.mean_directions[None, None].repeat(config.data.num_seed_frames, axis=1)
    model_folder.save(folder, config, Assets(skeleton, Vocabulary(()), {}, starts), variables)


def unchanged_step(objective, mesh):
    """Return a step in place of `sharding.compile_step` that changes no network; a real one compiles for 25 s."""
    return lambda state, batch, key, stop=False: (state.replace(step=state.step + 1), terms(objective) | {"stop": stop})


def constant_validation(objective, mesh):
    """Return a step in place of `sharding.compile_validation_step`."""
    return lambda state, batch, key: terms(objective)


def terms(objective):
    """Return the names of the terms of an objective with a number."""
    return {f"loss/{name}": np.float32(1) for name in (*objective.weights._asdict(), "total")}


@pytest.fixture
def clone(files, draw_state, tmp_path, monkeypatch):
    """A copy of `files` as the working folder, where little is compiled and `talk` is the tiny corpus."""
    shutil.copytree(files, tmp_path, symlinks=True, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HA2G_CACHE", str(tmp_path))
    monkeypatch.setattr("os.cpu_count", lambda: 1)  # processes start slowly
    monkeypatch.setattr(sharding, "compile_step", unchanged_step)
    monkeypatch.setattr(sharding, "compile_validation_step", constant_validation)
    monkeypatch.setattr(loop, "init_state", lambda objective, key, pretrained: draw_state(objective))
    monkeypatch.setattr(scoring, "evaluate", functools.partial(evaluate, draws=10))  # 1000 take up to half a minute


@pytest.mark.usefixtures("clone")
@pytest.mark.parametrize("page", [page for page, commands in RUN.items() if commands])
def test_commands_of_a_page_run(page, capsys):
    for command in RUN[page]:
        assert cli.main(command) == 0, f"{shlex.join(command)}: {capsys.readouterr().err}"
        shutil.rmtree("trained", ignore_errors=True)  # a workdir is of one config
