"""Every option of every command is honoured or refused, whatever is made of what."""

import argparse
from collections.abc import Iterator

import numpy as np
import pytest
import soundfile

from ha2g_jax import cli
from ha2g_jax.motion.motion import Motion
from ha2g_jax.skeleton import load_skeleton

# By command, what it can be asked to do, and the options that have no effect then.
REFUSED = {
    "generate": {
        "generate a.wav -o x.npz": "--size --camera",
        "generate a.wav -o x.html": "--size --rig",
        "generate a.wav -o x.mp4 --speaker ann": "--rig --words",
        "generate a.wav -o x.bvh --style-seed 1": "--size --variation --words",
    },
    "live": {
        "live --source a.wav --sink x.npz": "--fps --delay --rig",
        "live --source a.wav --sink vmc://127.0.0.1 --fast": "--delay --rig --rate",
        "live --source stdin --sink udp://127.0.0.1:9": "--fast",
        "live --source microphone --sink udp://127.0.0.1:9": "--fast --channels",
    },
    "export": {
        "export m.npz -o x.mp4": "--rig --words --count --unit --source-fps --joint-map",
        "export m.npz -o x.html": "--rig --size --fps --count --unit --source-fps --joint-map",
        "export m.npz -o x.png": "--rig --audio --fps --camera --unit --source-fps --joint-map",
        "export m.npz -o x.glb": "--words --names --size --fps --camera --count --unit --source-fps --joint-map",
        "export m.npz -o x.bvh": "--audio --words --names --size --fps --camera --count --unit --source-fps "
        "--joint-map",
        "export m.npz --format bvh -o x": "--audio --words --names --size --fps --camera --count --unit --source-fps "
        "--joint-map",
    },
    "runs": {"runs w": "--smooth", "runs w -o x.html": "--sort --json"},
    "doctor": {
        "doctor": "--checkpoint --batch-size --precision --steps --table1",
        "doctor --describe": "--checkpoint --batch-size --precision --steps --table1",
        "doctor --gradients": "--batch-size --precision --steps --table1",
        "doctor --benchmark --table1 ted_gesture": "--config --checkpoint --batch-size --precision",
    },
    "evaluate": {
        "evaluate --checkpoint demo --data c": "--skeleton --joint-map --source-fps --unit --protocol --body-model",
        "evaluate --checkpoint demo --speech a.wav": "--split --look-ahead --skeleton --joint-map --source-fps --unit "
        "--protocol --body-model --autoencoder --legacy --data",
        "evaluate --motion d --reference d": "--checkpoint --data --split --look-ahead --speech --body-model",
    },
    "genea pack": {
        "genea pack d -o x": "--joint-map --source-fps --unit --variation",
        "genea pack d -o x --motion d": "--checkpoint --seed --speaker --style --reference-image --style-seed "
        "--variation",
    },
    "data import": {
        "data import --kind ted d x": "--skeleton --fps --speaker --audio --words --no-words --joint-map --source-fps "
        "--unit --model --up --license",
        "data import --kind bvh d x": "--model --up --workers",
        "data import --kind smplx d x": "--joint-map --workers",
    },
    "data build-video": {
        "data build-video --install": "--settings --set --recognise --pose-command --runner --address --workers "
        "--overlay --split --license --json",
        "data build-video v.mp4 x": "--python --address",
    },
    "data inspect": {
        "data inspect d": "--samples --recording --joint-map --source-fps --unit",
        "data inspect d --check": "--samples --recording --joint-map --source-fps --unit --out",
        "data inspect d -o x.html": "--json --joint-map --source-fps --unit",
    },
    "study power": {
        "study power mos --difference 1": "--equal",
        "study power mos": "--share",
        "study power preference": "--difference",
        "study power preference --share 0.6": "--sd-rest --study",
    },
}  # fmt: skip
# Options that always have an effect, of these commands and of those that have no others.
ALWAYS = {
    "generate": "--out --takes --format --checkpoint --backend --seed --fps --speaker --style --reference-image "
    "--style-seed --energy --extent --handedness --mirror --seed-pose --pin --mute --cues --smooth",
    "live": "--source --sink --checkpoint --look-ahead --hop --seed --json --muted --state --speaker --style "
    "--reference-image --style-seed --energy --extent --handedness --mirror --variation",
    "export": "--out --format",
    "runs": "--out",
    "doctor": "--config --describe --benchmark --gradients --json",
    "evaluate": "--motion --reference --seed --json --markdown",
    "genea pack": "--out --samples --shapes --body-model --motion",
    "data import": "--kind --split --json",
    "data build-video": "--install",
    "data inspect": "--check",
    "study power": "--clips --items --comparisons --sd-participants --sd-clips --pilot --power --most",
}
WHOLE = {
    "speakers", "serve", "web", "study make", "study analyse", "genea check", "model export", "model onnx",
    "model publish", "model import", "model average", "data make-talk", "data merge", "data split", "train",
}  # fmt: skip
VALUES = {
    "--joint-map": "mixamo", "--words": "a.wav", "--rate": "8000", "--channels": "2", "--kind": "bvh",
    "--style": "ann:1", "--rig": "vrm", "--pin": "1:2:rest", "--mute": "1:2", "--up": "y", "--protocol": "beat2",
    "--skeleton": "ted_gesture",
    "--precision": "float32", "--runner": "ray", "--sort": "name", "--set": "fps=15", "--camera": "close",
    "--table1": "ted_gesture", "--config": "talk:small",
}  # fmt: skip


def leaves(parser: argparse.ArgumentParser, name: str = "") -> Iterator[tuple[str, argparse.ArgumentParser]]:
    below = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    for action in below:
        for command, of_command in action.choices.items():
            yield from leaves(of_command, f"{name} {command}".strip())
    if not below:
        yield name, parser


PARSERS = dict(leaves(cli.make_parser()))


def test_every_option_is_in_one_of_the_tables():
    assert {*REFUSED, *WHOLE} == {*PARSERS} and REFUSED.keys() == ALWAYS.keys()
    for name, kinds in REFUSED.items():
        options = {action.option_strings[-1] for action in PARSERS[name]._actions if action.option_strings} - {"--help"}
        sometimes = {option for refused in kinds.values() for option in refused.split()}
        assert options == sometimes | {*ALWAYS[name].split()}, name


def test_every_command_is_described_and_every_model_may_be_one_of_the_hub():
    for name, parser in PARSERS.items():
        assert parser.description or name == "train", name
        for action in parser._actions:
            if action.dest in ("checkpoint", "models"):
                assert "hf://OWNER/NAME" in (action.help or ""), name


@pytest.fixture
def folder(tmp_path, monkeypatch):
    skeleton = load_skeleton("ted_expressive")
    Motion.from_directions(skeleton, np.repeat(skeleton.mean_directions[None], 9, axis=0), 15).save(tmp_path / "m.npz")
    soundfile.write(tmp_path / "a.wav", np.random.default_rng(0).normal(0, 0.1, 16000), 16000)
    (tmp_path / "d").mkdir()
    monkeypatch.chdir(tmp_path)
    return tmp_path


CASES = [(kind, option) for kinds in REFUSED.values() for kind, refused in kinds.items() for option in refused.split()]


@pytest.mark.parametrize(("kind", "option"), CASES)
def test_an_option_without_an_effect_is_refused_by_its_name(folder, debug_folder, capsys, kind, option):
    """Before anything is done: nothing is written."""
    before = {*folder.rglob("*")}
    [action] = [one for parser in PARSERS.values() for one in parser._actions if option in one.option_strings][:1]
    value = [] if action.nargs == 0 else [VALUES.get(option, "1")]
    model = ["--checkpoint", str(debug_folder)] if kind.startswith("generate") else []
    assert cli.main([*kind.split(), *model, option, *value]) == 2
    line = capsys.readouterr().err.strip().splitlines()[-1]
    assert option in line and line.startswith("ha2g: "), line
    assert {*folder.rglob("*")} == before
