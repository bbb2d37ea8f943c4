"""The baselines take the same step, up to rounding, on several devices and in half precision."""

import dataclasses
import functools

import jax
import numpy as np
import optax
import pytest

from ha2g_jax.methods.build import method_of
from ha2g_jax.train import sharding
from ha2g_jax.train.step import step_keys, train_step

METHODS = ("joint_embedding", "trimodal")
SIZE = 8
# Short windows and few layers, which compile and run faster.
SMALL = {
    "joint_embedding": {"data__num_frames": 17, "model__context__layers": 1, "model__text__layers": 1},
    "trimodal": {"data__num_frames": 17},
}


@pytest.fixture(scope="module")
def make_plain(make_objective):
    """A function from a method's name to its objective under gradient descent and without dropout."""

    def make(method, **changes):
        changes |= SMALL[method] | {
            "model__text__dropout": 0.0,
            "model__inferer__dropout": 0.0,
            "train__batch_size": SIZE,
        }
        objective = make_objective(method, **changes)
        sgd = {"generator_optimizer": optax.sgd(1e-3), "discriminator_optimizer": optax.sgd(1e-2)}
        objective = dataclasses.replace(objective, **sgd)
        if objective.spec.discriminator is not None:
            discriminator = objective.spec.discriminator.clone(dropout=0.0)
            objective = dataclasses.replace(objective, spec=objective.spec._replace(discriminator=discriminator))
        return objective

    return make


@pytest.mark.parametrize("method", METHODS)
def test_eight_devices_take_the_step_of_one(method, make_plain, make_motion_batch, draw_state):
    objective = make_plain(method)
    batch, start, ends = make_motion_batch(objective, SIZE), draw_state(objective), []
    for devices in (jax.devices()[:1], jax.devices()):
        mesh = sharding.data_mesh(devices)
        step = jax.jit(functools.partial(train_step, objective))
        arguments = (sharding.replicate(mesh, start), sharding.shard_batch(mesh, jax.tree.map(np.asarray, batch)))
        ends.append(jax.device_get(step(*arguments, jax.random.key(1))))
    (one, one_metrics), (eight, metrics) = ends
    for name, value in one_metrics.items():
        assert metrics[name] == pytest.approx(value, rel=1e-3), name
    trees = [jax.tree.map(np.asarray, (state.generator, state.discriminator)) for state in (one, eight, start)]
    for (path, theirs), ours, before in zip(jax.tree.leaves_with_path(trees[0]), *map(jax.tree.leaves, trees[1:])):
        moved, scale = (np.max(np.abs(x), initial=0.0) for x in (theirs - before, theirs))
        # Biases before BatchNorm move by rounding alone.
        tolerance = 1e-2 * moved + 1e-6 * scale + 1e-7
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=tolerance, err_msg=jax.tree_util.keystr(path))


@pytest.mark.parametrize("method", METHODS)
def test_half_precision_is_near_single_precision(method, make_plain, make_motion_batch, draw_state):
    objectives = [make_plain(method, train__dtype=dtype) for dtype in ("float32", "bfloat16")]
    start, ends = draw_state(objectives[0]), []
    keys = step_keys(objectives[0].spec, jax.random.key(1), start.step)
    for objective in objectives:

        def run(batch, variables, objective=objective):
            spec = objective.spec
            outputs, _, batch_stats = method_of(spec).run(
                spec, variables, batch, keys, train=True, compute=objective.compute
            )
            return outputs.poses[-1], batch_stats

        ends.append(jax.jit(run)(make_motion_batch(objective, 4), start.generator.variables))
    (single, _), (half, batch_stats) = ends
    assert half.dtype == np.float32 and {leaf.dtype for leaf in jax.tree.leaves(batch_stats)} == {np.dtype("float32")}
    distance = np.max(np.abs(single - half)) / np.max(np.abs(single))
    assert 0 < distance < 0.05
