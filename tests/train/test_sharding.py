"""Eight devices give the numbers of one."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ha2g_jax.errors import UserError
from ha2g_jax.train import sharding


def run(task, state, batches, num_devices):
    mesh = sharding.data_mesh(jax.devices()[:num_devices])
    step: Any = sharding.compile_step(task, mesh)
    state = sharding.replicate(mesh, state)
    history = []
    for batch in batches:
        state, metrics = step(state, sharding.shard_batch(mesh, batch), jax.random.key(1))
        history.append(metrics)
    assert step._cache_size() == 1
    return jax.device_get((state, history))


def test_eight_devices_equal_one(task, state, make_batch):
    assert jax.device_count() == 8
    batches = [make_batch(task, 8, seed) for seed in range(3)]
    one, eight = (run(task, state, batches, num_devices) for num_devices in (1, 8))
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-5), one, eight)


def test_validation_runs_on_the_mesh(task, state, make_batch):
    batch, results = make_batch(task, 8), []
    for num_devices in (1, 8):
        mesh = sharding.data_mesh(jax.devices()[:num_devices])
        validate = sharding.compile_validation_step(task, mesh)
        results.append(validate(sharding.replicate(mesh, state), sharding.shard_batch(mesh, batch), jax.random.key(1)))
    for name, value in results[0].items():
        np.testing.assert_allclose(value, results[1][name], rtol=1e-4)


def test_batch_is_split_and_state_is_whole(task, make_batch):
    mesh = sharding.data_mesh()
    batch = sharding.shard_batch(mesh, make_batch(task, 16))
    assert {shard.data.shape for shard in batch["mel"].addressable_shards} == {(2, 128, 70)}
    whole = sharding.replicate(mesh, jnp.arange(3))
    assert {shard.data.shape for shard in whole.addressable_shards} == {(3,)}


def test_batch_that_does_not_split_is_refused(task, make_batch):
    with pytest.raises(UserError, match="batch of 6 does not split over 8 devices"):
        sharding.shard_batch(sharding.data_mesh(), make_batch(task, 6))
