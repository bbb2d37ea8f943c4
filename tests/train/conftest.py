"""The smallest task and batch that show what a step of training does."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from ha2g_jax import config as configs
from ha2g_jax.skeleton import load_skeleton, normalize
from ha2g_jax.train.building import build_task
from ha2g_jax.train.state import init_state
from ha2g_jax.train.step import train_step

NUM_WORDS, NUM_SPEAKERS = 11, 5


@pytest.fixture
def config(make_config):
    """TED-Gesture (three levels) at debug size, with dropout and one epoch of warm-up."""
    return make_config()


@pytest.fixture(scope="session")
def make_config():
    """A function that makes `config`."""
    return _config


def _config():
    config = configs.debug(configs.paper("ted_gesture"))
    config.model.identity.kind = "speakers"
    config.model.inferer.layers = 2
    config.model.inferer.dropout = 0.3
    config.train.warmup_epochs = 1
    return config


@pytest.fixture(scope="session")
def build():
    """`build_task` of a config on TED-Gesture."""
    return functools.partial(
        build_task, skeleton=load_skeleton("ted_gesture"), vocabulary_size=NUM_WORDS, num_speakers=NUM_SPEAKERS
    )


@pytest.fixture(scope="session")
def task(build):
    """Two steps of warm-up, then plain gradient descent, whose updates are in proportion to the gradients."""
    task = build(_config(), steps_per_epoch=2)
    return dataclasses.replace(task, generator_optimizer=optax.sgd(1e-4), discriminator_optimizer=optax.sgd(1e-2))


@pytest.fixture(scope="session")
def state(task):
    """A fresh state of `task`, its warm-up over."""
    return init_state(task, jax.random.key(0)).replace(step=jnp.int32(task.warmup_steps))


@pytest.fixture(scope="session")
def step(task):
    """The compiled step of `task`; call it with the shapes of `batch`."""
    return jax.jit(functools.partial(train_step, task))


@pytest.fixture(scope="session")
def batch(task, make_batch):
    """Three windows of noise."""
    return make_batch(task, 3)


@pytest.fixture(scope="session")
def make_batch():
    """A function from a task and a size to a batch of noise in the right shapes and units."""

    def make(task, size, seed=0):
        rng = np.random.default_rng(seed)
        directions = rng.normal(size=(size, task.num_frames, task.skeleton.num_bones, 3))
        images = (size, task.num_reference_frames, task.image_size, task.image_size, 3)
        return {
            "mel": rng.uniform(-80, 0, (size, 128, 70)).astype(np.float32),
            "words": rng.integers(0, NUM_WORDS, (size, task.num_frames)).astype(np.int32),
            "directions": normalize((0.3 * directions + task.skeleton.mean_directions).astype(np.float32)),
            "speaker": rng.integers(0, NUM_SPEAKERS, size).astype(np.int32),
            "frames": rng.integers(0, 256, images).astype(np.uint8),
        }

    return make
