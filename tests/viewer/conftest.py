"""A motion that moves every bone, smoothly."""

import numpy as np
import pytest

from ha2g_jax.motion.motion import Motion
from ha2g_jax.skeleton import load_skeleton


@pytest.fixture(scope="session")
def make_motion():
    """A function from a skeleton's name, frames and a frame rate to a motion about the mean pose."""

    def make(name="ted_expressive", frames=30, fps=15.0, seed=0):
        skeleton = load_skeleton(name)
        random = np.random.default_rng(seed)
        phases, speeds = random.uniform(0, 6, (2, skeleton.num_bones, 3))
        time = np.arange(frames)[:, None, None] / fps
        return Motion.from_directions(skeleton, skeleton.mean_directions + 0.5 * np.sin(phases + speeds * time), fps)

    return make
