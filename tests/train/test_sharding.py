"""The results do not depend on the number of devices and processes."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from train import processes

from ha2g_jax.errors import UserError
from ha2g_jax.train import sharding

NUM_STEPS, BATCH_SIZE = 5, 8


@pytest.fixture(scope="module")
def start(draw_state, make_batch):
    """Objective, state and batches for `NUM_STEPS` steps of plain gradient descent with all terms of the objective."""
    objective = processes.sgd_objective("ha2g")
    batches = [make_batch(objective, BATCH_SIZE, seed) for seed in range(NUM_STEPS)]
    return objective, warm_state(draw_state, objective), batches


def warm_state(draw_state, objective):
    """Return a state after the warm-up with random biases: the error of an array is measured by its largest value."""
    state = draw_state(objective, seed=3, biases=0.05)
    return jax.device_get(state.replace(step=jnp.int32(objective.warmup_steps)))


def assert_same_parameters(found, expected, before):
    """Check that arrays move by the same to a hundredth, and to 1e-6 of their largest value, which is rounding."""
    moved = []
    named = jax.tree_util.tree_leaves_with_path(expected)
    for (path, b), a, c in zip(named, found, jax.tree.leaves(before), strict=True):
        if "params" in (name := jax.tree_util.keystr(path)):
            rounding, movement = 1e-6 * np.abs(b).max(), np.abs(b - c).max()
            np.testing.assert_allclose(a, b, rtol=0, atol=0.01 * movement + rounding, err_msg=name)
            moved.append(movement / rounding)
    assert np.median(moved) > 200


def test_eight_devices_equal_one(start):
    assert jax.device_count() == 8
    objective, state, batches = start
    alone = processes.train(objective, state, batches, jax.devices()[:1])
    eight, history = processes.train(objective, state, batches, jax.devices())
    assert_same_parameters(jax.tree.leaves(eight), alone[0], state)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-5), (eight, history), alone)


def test_two_processes_equal_one_and_agree_on_the_end(draw_state, make_motion_batch, tmp_path):
    """Trimodal has what processes must agree on: sums of gradients and of BatchNorm, dropout, and a discriminator."""
    objective = processes.sgd_objective("trimodal")
    state = warm_state(draw_state, objective)
    batches = [jax.device_get(make_motion_batch(objective, BATCH_SIZE, seed)) for seed in range(NUM_STEPS)]
    alone, _ = processes.train(objective, state, batches, jax.devices()[:1])
    found, stops = processes.train_in_processes(tmp_path, state, batches, count=2, devices=1)
    assert_same_parameters(found, alone, state)
    assert [step for step, is_end in enumerate(stops) if is_end] == [processes.STOP_AT]  # asked for by the second


def test_a_step_is_compiled_once(start, monkeypatch):
    objective, state, (batch, *_) = start
    traces = []
    monkeypatch.setattr(sharding, "train_step", lambda objective, state, batch, key: (traces.append(1), (state, {}))[1])
    mesh = sharding.data_mesh()
    step, state = sharding.compile_step(objective, mesh), sharding.replicate(mesh, state)
    for stop in (False, True, False):
        state, metrics = step(state, sharding.shard_batch(mesh, batch), jax.random.key(1), stop)
        assert bool(metrics["stop"]) is stop
    assert len(traces) == 1


def test_validation_runs_on_the_mesh(start):
    (objective, state, (batch, *_)), results = start, []
    for num_devices in (1, 8):
        mesh = sharding.data_mesh(jax.devices()[:num_devices])
        validate = sharding.compile_validation_step(objective, mesh)
        results.append(validate(sharding.replicate(mesh, state), sharding.shard_batch(mesh, batch), jax.random.key(1)))
    for name, value in results[0].items():
        np.testing.assert_allclose(value, results[1][name], rtol=1e-4)


@pytest.mark.parametrize("original", [np.zeros(4096, np.float32), jnp.zeros(4096)], ids=["numpy", "jax"])
def test_what_was_replicated_stays_valid_when_the_copy_is_given_up(original):
    copies = sharding.replicate(sharding.data_mesh(), original)
    added = jax.jit(lambda x: x + 1, donate_argnums=0)(copies)
    assert copies.is_deleted()
    np.testing.assert_array_equal(original, 0)
    assert all(np.all(np.asarray(shard.data) == 1) for shard in added.addressable_shards)


def test_hosts_with_unequal_devices_are_refused(monkeypatch):
    monkeypatch.setattr(jax, "process_count", lambda: 2)  # the second host brings none of these devices
    with pytest.raises(UserError, match=r"hosts have 8, 0 devices.* --config\.train\.devices=0"):
        sharding.data_mesh()


def test_a_batch_on_cpus_has_been_copied():
    """JAX runs a program in the thread that calls it, whose memory is kept, only if the arguments are ready."""
    array = np.ones((8, (1 << 22) + 1), np.float32)[:, 1:]  # its memory cannot be used as it is

    def is_ready(batch: dict[str, Any]) -> bool:
        return batch["x"].is_ready()

    assert all(is_ready(sharding.shard_batch(sharding.data_mesh(), {"x": array})) for _ in range(5))
