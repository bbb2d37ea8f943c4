"""Every config at every size describes a model that can be built, and at debug size one that can be trained."""

import functools
import pathlib

import jax
import jax.numpy as jnp
import pytest

from ha2g_jax import config as configs
from ha2g_jax import launch
from ha2g_jax.errors import UserError
from ha2g_jax.skeleton import load_skeleton
from ha2g_jax.train.state import init_state
from ha2g_jax.train.step import train_step
from ha2g_jax.train.task import build_task, example_batch

FILES = sorted((pathlib.Path(__file__).parent.parent / "experiments" / "configs").glob("*.py"))


@pytest.mark.parametrize("size", configs.SIZES)
@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_every_config_builds_a_task(path, size):
    config = launch.load_config(f"{path}:{size}")
    task = build_task(config, load_skeleton(config.skeleton), vocabulary_size=10, num_speakers=3)
    assert len(task.generator.level_channels) == {"ted_expressive": 6, "ted_gesture": 3}[config.skeleton]
    assert task.num_frames == 34 and task.num_seed_frames == 4


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_every_debug_config_gives_a_step(path):
    config = launch.load_config(f"{path}:debug")
    task = build_task(config, load_skeleton(config.skeleton), vocabulary_size=10, num_speakers=3)
    key = jax.random.key(0)
    batch = {name: jnp.repeat(array, 2, axis=0) for name, array in example_batch(task).items()}
    state = jax.eval_shape(functools.partial(init_state, task), key)
    after, metrics = jax.eval_shape(functools.partial(train_step, task), state, batch, key)
    assert jax.tree.map(lambda leaf: (leaf.shape, leaf.dtype), after) == jax.tree.map(
        lambda leaf: (leaf.shape, leaf.dtype), state
    )
    assert {f"loss/{name}" for name in config.loss.weights} < metrics.keys()


def test_an_unknown_size_is_named():
    with pytest.raises(UserError, match="'huge'; expected one of paper, small, debug"):
        configs.sized(configs.paper("ted_gesture"), "huge")
