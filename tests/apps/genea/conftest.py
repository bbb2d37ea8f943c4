"""Speech of two clips with names of BEAT2, and the made-up person of tests/motion/readers in each layout."""

import pathlib
import shutil

import numpy as np
import pytest
import soundfile
from motion.readers.conftest import files, person  # noqa: F401

from ha2g_jax.apps.genea.pack import write_pack

SECONDS = {"1_wayne_0_1_1": 2.31, "2_scott_0_3_3": 3.0}
FRAMES = {"1_wayne_0_1_1": 69, "2_scott_0_3_3": 90}  # round(30 x seconds)


@pytest.fixture(scope="session")
def speech(tmp_path_factory) -> pathlib.Path:
    folder = tmp_path_factory.mktemp("speech")
    for name, seconds in SECONDS.items():
        soundfile.write(folder / f"{name}.wav", np.random.default_rng(0).normal(0, 0.1, round(16000 * seconds)), 16000)
    return folder


@pytest.fixture(scope="session")
def written(speech, debug_folder, tmp_path_factory) -> pathlib.Path:
    """A pack of five samples of each clip."""
    return write_pack(speech, tmp_path_factory.mktemp("packs") / "pack", checkpoint=debug_folder, seed=7)


@pytest.fixture
def pack(written, tmp_path) -> pathlib.Path:
    """A copy of the pack, to be changed."""
    return pathlib.Path(shutil.copytree(written, tmp_path / "pack"))
