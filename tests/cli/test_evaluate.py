"""`ha2g evaluate`: results of one shape for every input and form, or one line on an option that does not apply."""

import functools
import json

import numpy as np
import pytest
import soundfile

from ha2g_jax import cli, synthesis
from ha2g_jax.evaluation import scoring
from ha2g_jax.evaluation.evaluate import evaluate as evaluate_motion
from ha2g_jax.motion.motion import Motion
from ha2g_jax.skeleton import load_skeleton


@pytest.fixture(autouse=True)
def few_draws(monkeypatch):
    """Intervals of ten draws; 1000 take most of the time of an evaluation."""
    monkeypatch.setattr(scoring, "evaluate", functools.partial(evaluate_motion, draws=10))


@pytest.fixture
def folders(tmp_path):
    """Two clips of motion and their reference with sound."""
    skeleton, random = load_skeleton("ted_gesture"), np.random.default_rng(0)
    for folder in ("mine", "true"):
        (tmp_path / folder).mkdir()
        for name in ("one", "two"):
            waves = np.sin(np.arange(90)[:, None, None] * random.uniform(0.2, 0.6, (1, skeleton.num_bones, 3)))
            directions = skeleton.mean_directions + 0.2 * waves.astype(np.float32)
            Motion.from_directions(skeleton, directions, 15).save(tmp_path / folder / f"{name}.npz")
    for name in ("one", "two"):
        clicks = np.zeros(96000, np.float32)
        clicks[random.integers(0, 96000, 12)] = 1
        soundfile.write(tmp_path / "true" / f"{name}.wav", clicks, 16000)
    return tmp_path / "mine", tmp_path / "true"


def evaluate(*arguments) -> int:
    return cli.main(["evaluate", *map(str, arguments)])


def test_without_an_input_nothing_is_scored(capsys):
    assert evaluate("--split", "test") == 2
    line = capsys.readouterr().err
    assert line.startswith("ha2g: nothing to score; give --checkpoint MODEL --data CORPUS") and line.count("\n") == 1


def test_an_option_that_does_not_apply_is_refused_in_one_line(capsys):
    assert evaluate("--motion", "a", "--reference", "b", "--split", "test") == 2
    line = "ha2g: --split does not apply to --motion with --reference"
    shown = capsys.readouterr()
    assert not shown.out and shown.err.startswith(line) and shown.err.count("\n") == 1


@pytest.fixture
def checkpoint(debug_model, monkeypatch):
    monkeypatch.setattr(synthesis, "load", lambda checkpoint: debug_model)
    return "any"


def shape(results: dict) -> dict:
    """What results of every input have in common."""
    return {key: type(value) for key, value in results.items()} | {
        key: type(value)
        for section in results["sections"].values()
        for key, value in section.items()
        if key not in ("legacy_v1", "known_causes", "recording", "autoencoder")
    }


@pytest.fixture
def evaluated_once(monkeypatch):
    """Each input is evaluated once, and its results are shown in all forms."""

    def once(function):
        found = {}

        def call(*given, **options):
            if (key := repr((given, options))) not in found:
                found[key] = function(*given, **options)
            return found[key]

        return call

    for name in ("evaluate_folders", "evaluate_recording", "evaluate_checkpoint"):
        monkeypatch.setattr(scoring, name, once(getattr(scoring, name)))


def test_one_file_of_motion_is_scored_against_its_recording(debug_model, tmp_path, capsys):
    speech = "examples/hello.wav"
    debug_model.generate(speech).save(tmp_path / "take.npz")
    assert evaluate("--motion", tmp_path / "take.npz", "--speech", speech, "--json") == 0
    section = json.loads(capsys.readouterr().out)["sections"]["hello.wav"]
    scores = section["recording"]["rows"]["motion"]
    assert section["methods"] == ["motion"] and 0 <= scores["recording_f"]["value"] <= 1
    assert evaluate("--motion", tmp_path, "--speech", speech) == 2
    assert "give one file with --motion" in capsys.readouterr().err


@pytest.mark.usefixtures("evaluated_once")
def test_every_input_has_results_of_one_shape_in_every_form(folders, checkpoint, tiny_talk, tmp_path, capsys):
    """On Talk the known causes are part of them, without an option that switches programmes."""
    mine, true = folders
    audio = np.concatenate([soundfile.read(path)[0] for path in sorted(true.glob("*.wav"))])
    soundfile.write(tmp_path / "speech.wav", audio, 16000)
    given_for = {
        "true": ("--motion", mine, "--reference", true),
        "speech.wav": ("--checkpoint", checkpoint, "--speech", tmp_path / "speech.wav"),
        "test": ("--checkpoint", checkpoint, "--data", tiny_talk, "--split", "test", "val"),
    }
    shapes, results, shown = [], {}, {}
    for name, given in given_for.items():
        shown = {}
        for form in ("--json", "--markdown", None):
            assert evaluate(*given, *([form] if form else [])) == 0
            shown[form] = capsys.readouterr().out
        results = json.loads(shown["--json"])
        shapes.append(shape(results))
        assert name in results["sections"]
        if name == "true":
            rows = {"mine", "ground truth", "mean pose", "frozen", "mismatched speech", "white jitter"}
            assert rows <= results["sections"]["true"]["rows"].keys()
        titles = [metric["title"] for metric in results["metrics"].values()]
        for form, heading in (("--markdown", f"## {name}"), (None, f"{name}:")):
            assert heading in shown[form]
            assert sum(title in shown[form] for title in titles) > 0.8 * len(titles)
    assert shapes[0] == shapes[1] == shapes[2]
    assert list(results["sections"]) == ["test", "val"]
    assert all("known_causes" in section for section in results["sections"].values())
    for form in ("--markdown", None):
        assert "Known causes" in shown[form] and "white jitter" in shown[form]


@pytest.mark.parametrize("split", [True, False])
def test_each_folder_of_motion_is_a_row(folders, split, tmp_path, capsys):
    mine, true = folders
    other = tmp_path / "theirs"
    other.mkdir()
    motion = Motion.load(mine / "one.npz")
    Motion.from_directions(motion.skeleton, motion.directions[::-1], 15).save(other / "one.npz")
    given = ["--motion", mine, "--motion", other] if split else ["--motion", mine, other]
    assert evaluate(*given, "--reference", true, "--json") == 0
    section = json.loads(capsys.readouterr().out)["sections"]["true"]
    assert section["methods"] == ["mine", "theirs"]
    assert "theirs - mine" in section["differences"]
    assert any(
        "theirs: files of reference that have no counterpart and are left out: 1" in note for note in section["notes"]
    )
