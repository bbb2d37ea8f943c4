"""`ha2g evaluate` on folders of motion and on a corpus without known strokes: a table or JSON, or one line."""

import json

import numpy as np
import pytest
import soundfile

from ha2g_jax import cli
from ha2g_jax.motion.motion import Motion
from ha2g_jax.skeleton import load_skeleton


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


def test_folders_give_json_with_the_sanity_rows(folders, capsys):
    mine, true = folders
    assert evaluate("--motion", mine, "--reference", true, "--json") == 0
    rows = json.loads(capsys.readouterr().out)["rows"]
    assert {"mine", "ground truth", "mean pose", "frozen", "mismatched speech", "white jitter"} <= rows.keys()


@pytest.mark.parametrize("form", [(), ("--markdown",)])
def test_folders_give_a_table(folders, form, capsys):
    mine, true = folders
    assert evaluate("--motion", mine, "--reference", true, *form) == 0
    shown = capsys.readouterr().out
    assert all(row in shown for row in ("mine", "white jitter", "autoencoder"))


def test_one_folder_alone_is_refused(folders, capsys):
    assert evaluate("--motion", folders[0]) == 2
    assert capsys.readouterr().err == "ha2g: --motion and --reference go together; give both folders\n"


def test_several_splits_are_refused_where_one_is_scored(tiny_talk, capsys):
    assert evaluate("--data", tiny_talk, "--legacy", "--split", "test", "val") == 2
    assert "name one with --split" in capsys.readouterr().err
