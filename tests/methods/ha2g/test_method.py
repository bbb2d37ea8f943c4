"""A batch in parts gives the update of the whole batch on any number of devices, in less memory."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from ha2g_jax.train import sharding
from ha2g_jax.train.objective import init_state
from ha2g_jax.train.step import run_generator, step_keys, train_step

SIZE = 16


@pytest.fixture
def objectives(config, build):
    """The same objective with the batch as a whole and in 2 parts, under gradient descent and without dropout."""
    config.model.text.dropout = config.model.inferer.dropout = 0.0
    config.model.inferer.layers = 1
    config.train.batch_size = SIZE

    def make(count):
        config.train.accumulate = count
        objective = build(config)
        return dataclasses.replace(
            objective,
            optimizer=optax.scale(-1.0),
            generator_rate=optax.constant_schedule(1e-3),
            discriminator_rate=optax.constant_schedule(1e-2),
            spec=objective.spec._replace(discriminator=objective.spec.discriminator.clone(dropout=0.0)),
        )

    return make(1), make(2)


def residuals(objective, state, batch):
    """Return the shapes of the values that the forward pass of the generator keeps for the gradient."""

    def run(state, batch, key):
        return run_generator(objective, state.generator, batch, step_keys(objective.spec, key, state.step))[1]

    leaves = jax.tree.leaves(jax.eval_shape(run, state, batch, jax.random.key(1)))
    return [leaf for leaf in leaves if not jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)]


def num_bytes(leaves):
    return sum(leaf.size * leaf.dtype.itemsize for leaf in leaves)


def test_parts_on_eight_devices_give_the_update_of_the_whole_on_one(objectives, make_batch):
    batch, ends = make_batch(objectives[0], SIZE), []
    start = jax.tree.map(np.asarray, init_state(objectives[0], jax.random.key(0)))
    for objective, devices in zip(objectives, (jax.devices()[:1], jax.devices()), strict=True):
        mesh = sharding.data_mesh(devices)
        step = jax.jit(functools.partial(train_step, objective))
        ends.append(step(sharding.replicate(mesh, start), sharding.shard_batch(mesh, batch), jax.random.key(1)))
    (whole, whole_metrics), (parts, metrics) = jax.device_get(ends)
    for name, value in whole_metrics.items():
        assert metrics[name] == pytest.approx(value, rel=1e-4), name
    for (path, before), one, other in zip(
        jax.tree.leaves_with_path(start), jax.tree.leaves(whole), jax.tree.leaves(parts), strict=True
    ):
        scale = np.max(np.abs(one), initial=1e-3)
        np.testing.assert_allclose(other, one, rtol=0, atol=1e-5 * scale, err_msg=jax.tree_util.keystr(path))
        moved = np.max(np.abs(one.astype(float) - before))
        assert np.max(np.abs(other.astype(float) - one)) <= max(1e-2 * moved, 1e-6 * scale), path


@pytest.mark.parametrize("kind", ["speakers", "images"])
def test_parts_keep_less_for_the_gradient(config, build, make_batch, kind):
    config.model.identity.kind = kind
    config.train.batch_size = SIZE
    kept = []
    for config.train.accumulate in (1, 4):
        objective = build(config)
        state = jax.eval_shape(functools.partial(init_state, objective), jax.random.key(0))
        kept.append(
            num_bytes(residuals(objective, state, make_batch(objective, SIZE)))
            - num_bytes(jax.tree.leaves(state.model))
        )
    assert kept[1] < kept[0] / 3
