"""A baseline trained by the launcher generates from a recording, with the words that lie beside it or without."""

import pathlib

import numpy as np
import pytest
import soundfile

from ha2g_jax import cli
from ha2g_jax.apps.generate import generate_files
from ha2g_jax.errors import UserError
from ha2g_jax.motion.motion import Motion

METHODS = ("seq2seq", "speech2gesture", "joint_embedding", "trimodal")


def train(method: str, corpus: pathlib.Path, workdir: pathlib.Path) -> None:
    command = ["train", "--config", f"{method}:talk:debug", f"--workdir={workdir}"]
    assert cli.main([*command, f"--config.data.path={corpus}", "--config.train.steps=2"]) == 0


@pytest.mark.parametrize("method", METHODS)
def test_from_training_to_motion(method, tiny_talk, tmp_path, capsys):
    """The words beside the speech change what those do that read them, and only those."""
    soundfile.write(tmp_path / "speech.wav", np.random.default_rng(0).normal(0, 0.1, 40000), 16000)
    train(method, tiny_talk, tmp_path / "run")
    generate_files(tmp_path / "speech.wav", tmp_path / "without", tmp_path / "run")
    (tmp_path / "speech.tsv").write_text("0.2\t0.6\tthree\n1.0\t1.5\tnever\n")
    generate_files(tmp_path / "speech.wav", tmp_path / "with", tmp_path / "run")
    assert capsys.readouterr().err.count("has no transcript beside it") == (method != "speech2gesture")
    without, with_words = (Motion.load(tmp_path / f"{name}.npz") for name in ("without", "with"))
    assert with_words.num_frames == 38 and np.isfinite(with_words.positions).all()
    assert np.array_equal(without.directions, with_words.directions) == (method == "speech2gesture")


def test_an_auto_encoder_generates_nothing_and_says_so(tiny_talk, tmp_path):
    soundfile.write(tmp_path / "speech.wav", np.zeros(20000), 16000)
    train("autoencoder", tiny_talk, tmp_path / "run")
    with pytest.raises(UserError, match="is of autoencoder, which generates no motion"):
        generate_files(tmp_path / "speech.wav", tmp_path / "out", tmp_path / "run")
