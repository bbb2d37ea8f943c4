"""Debug-size tasks of the baselines on TED-Gesture, and batches that a network can learn."""

import jax.numpy as jnp
import numpy as np
import pytest

from ha2g_jax import presets
from ha2g_jax.skeleton import load_skeleton, normalize
from ha2g_jax.train.building import build_task

NUM_WORDS, NUM_SPEAKERS = 11, 5


@pytest.fixture(scope="session")
def make_task():
    """A function from a method's name and changes of its config, by dotted name, to a task."""

    def make(method, /, **changes):
        config = presets.make(
            "ted_gesture", "debug", method, {name.replace("__", "."): changes[name] for name in changes}
        )
        return build_task(config, load_skeleton("ted_gesture"), NUM_WORDS, NUM_SPEAKERS)

    return make


@pytest.fixture(scope="session")
def make_motion_batch():
    """A function from a task and a size to a batch of noise as speech, with smooth motion."""

    def make(task, size, seed=0):
        rng = np.random.default_rng(seed)
        time = np.arange(task.num_frames)[None, :, None, None] / task.num_frames
        bones = (task.skeleton.num_bones, 3)
        phase, height = rng.uniform(0, 1, (size, 1, *bones)), 0.5 * rng.normal(size=(size, 1, *bones))
        motion = height * np.sin(np.pi * (time + 2 * phase))
        inputs = {
            "mel": rng.uniform(-80, 0, (size, 128, 70)).astype(np.float32),
            "audio": 0.3 * rng.normal(size=(size, 36_267)).astype(np.float32),
            "words": rng.integers(0, NUM_WORDS, (size, task.num_frames)).astype(np.int32),
            "plain_words": rng.integers(0, NUM_WORDS, (size, 32)).astype(np.int32),
        }
        return {name: jnp.asarray(inputs[name]) for name in task.inputs} | {
            "directions": jnp.asarray(normalize((task.skeleton.mean_directions + motion).astype(np.float32))),
            "speaker": jnp.asarray(rng.integers(0, NUM_SPEAKERS, size).astype(np.int32)),
        }

    return make
