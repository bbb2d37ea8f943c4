"""Folders of motion of two systems with the sound of their clips, and a study made of them."""

import numpy as np
import pytest
import soundfile

from ha2g_jax.apps.user_study.make import make_study
from ha2g_jax.motion.motion import Motion
from ha2g_jax.skeleton import load_skeleton

SYSTEMS = ("Secret Alpha", "Secret Beta")
CLIPS = ("clip-one", "clip-two")
SECONDS = 1.2
POST = "http://127.0.0.1:{port}/answers"


@pytest.fixture(scope="session")
def write_motions():
    """A function that writes motion of clips to folders of systems, and tones to `speech`, below a folder."""

    def write(root, systems=SYSTEMS, clips=CLIPS, seconds=SECONDS):
        skeleton = load_skeleton("ted_expressive")
        for row, system in enumerate(systems):
            for column, clip in enumerate(clips):
                random = np.random.default_rng([row, column])
                waves = np.sin(np.arange(round(seconds * 15))[:, None, None] * random.uniform(0.1, 0.3, (42, 3)))
                path = root / system / f"{clip}.npz"
                path.parent.mkdir(parents=True, exist_ok=True)
                Motion.from_directions(skeleton, skeleton.mean_directions + 0.2 * waves, 15).save(path)
        for column, clip in enumerate(clips):
            tone = 0.3 * np.sin(np.arange(round(seconds * 16000)) * (0.1 + 0.02 * column))
            path = root / "speech" / f"{clip}.wav"
            path.parent.mkdir(parents=True, exist_ok=True)
            with path.open("wb") as file:
                soundfile.write(file, tone, 16000, format="WAV")
        return [str(root / system) for system in systems]

    return write


@pytest.fixture(scope="session")
def study(write_motions, tmp_path_factory):
    """A study of all parts, with videos of 64 pixels; tests must not change it."""
    root = tmp_path_factory.mktemp("study")
    folders = write_motions(root)
    protocol = ("rating", "preference", "mismatch")
    title = "Gestures & <speech>"
    return make_study(
        folders, root / "study", speech=root / "speech", protocol=protocol, attention=1, size=64, seed=7, title=title
    )
