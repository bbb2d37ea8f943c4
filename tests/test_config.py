"""Every config at every size describes a model that can be built, and at debug size one that can be trained."""

import functools
import pathlib

import jax
import jax.numpy as jnp
import pytest

from ha2g_jax import launch
from ha2g_jax.config import presets
from ha2g_jax.config import settings as configs
from ha2g_jax.errors import UserError
from ha2g_jax.methods.method import example_batch
from ha2g_jax.skeleton import load_skeleton
from ha2g_jax.train.objective import build_objective, init_state
from ha2g_jax.train.step import train_step

FILES = sorted((pathlib.Path(__file__).parent.parent / "experiments" / "configs").glob("*.py"))


# A file is of a data set, or of a method, which takes the data's name before the size.
SPECS = [f"{path}:talk" if path.stem in presets.METHODS else str(path) for path in FILES]


@pytest.mark.parametrize("size", configs.SIZES)
@pytest.mark.parametrize("spec", SPECS, ids=lambda spec: pathlib.Path(spec).name)
def test_every_config_builds_a_task(spec, size):
    config = launch.load_config(f"{spec}:{size}")
    objective = build_objective(config, load_skeleton(config.skeleton), vocabulary_size=10, num_speakers=3)
    if config.method == "ha2g":
        assert len(objective.spec.generator.level_channels) == {"ted_expressive": 6, "ted_gesture": 3}[config.skeleton]
    assert objective.spec.num_frames == 34 and objective.spec.num_seed_frames == 4


@pytest.mark.parametrize("spec", SPECS, ids=lambda spec: pathlib.Path(spec).name)
def test_every_debug_config_gives_a_step(spec):
    config = launch.load_config(f"{spec}:debug")
    if pathlib.Path(spec).stem in ("talk", "bvh", "video"):  # ted_expressive.py has all six
        config.model.inferer.levels = (6,)
    objective = build_objective(config, load_skeleton(config.skeleton), vocabulary_size=10, num_speakers=3)
    key = jax.random.key(0)
    batch = {name: jnp.repeat(array, 2, axis=0) for name, array in example_batch(objective.spec).items()}
    state = jax.eval_shape(functools.partial(init_state, objective), key)
    after, metrics = jax.eval_shape(functools.partial(train_step, objective), state, batch, key)
    assert jax.tree.map(lambda leaf: (leaf.shape, leaf.dtype), after) == jax.tree.map(
        lambda leaf: (leaf.shape, leaf.dtype), state
    )
    assert {f"loss/{name}" for name in config.loss[config.method].weights} < metrics.keys()


def test_an_unknown_size_is_named():
    with pytest.raises(UserError, match="'huge'; expected one of paper, medium, small, study, debug"):
        configs.sized(configs.paper("ted_gesture"), "huge")
