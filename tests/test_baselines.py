"""A baseline trained by the launcher generates from a recording, with the words that lie beside it or without."""

import pathlib
import subprocess
import sys

import numpy as np
import pytest
import soundfile

from ha2g_jax.motion.motion import Motion

CONFIGS = pathlib.Path(__file__).parent.parent / "experiments" / "configs"
METHODS = ("seq2seq", "speech2gesture", "joint_embedding", "trimodal")

# All in one process, so that programs are compiled once.
PROGRAM = """
import pathlib, sys
from ha2g_jax import cli
from ha2g_jax.synthesis import generate_files

config, corpus, folder = sys.argv[1:]
folder = pathlib.Path(folder)
assert cli.main(["train", "--config", config, f"--workdir={folder / 'run'}", f"--config.data.path={corpus}"]) == 0
generate_files(folder / "speech.wav", folder / "without", folder / "run")
(folder / "speech.tsv").write_text("0.2\\t0.6\\tthree\\n1.0\\t1.5\\tnever\\n")
generate_files(folder / "speech.wav", folder / "with", folder / "run")
"""


def run(program: str, *arguments) -> subprocess.CompletedProcess:
    command = [sys.executable, "-c", program, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("method", METHODS)
def test_from_training_to_motion(method, tiny_talk, tmp_path):
    """The words beside the speech change what those do that read them, and only those."""
    soundfile.write(tmp_path / "speech.wav", np.random.default_rng(0).normal(0, 0.1, 40000), 16000)
    done = run(PROGRAM, f"{CONFIGS / method}.py:talk:debug", tiny_talk, tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stderr.count("has no transcript beside it") == (method != "speech2gesture")
    without, with_words = (Motion.load(tmp_path / f"{name}.npz") for name in ("without", "with"))
    assert with_words.num_frames == 38 and np.isfinite(with_words.positions).all()
    assert np.array_equal(without.directions, with_words.directions) == (method == "speech2gesture")


def test_an_auto_encoder_generates_nothing_and_says_so(tiny_talk, tmp_path):
    soundfile.write(tmp_path / "speech.wav", np.zeros(20000), 16000)
    done = run(PROGRAM, f"{CONFIGS}/autoencoder.py:talk:debug", tiny_talk, tmp_path)
    assert done.returncode == 1 and "is of autoencoder, which generates no motion" in done.stderr
