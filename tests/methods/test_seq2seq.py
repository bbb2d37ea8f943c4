"""Attention Seq2Seq: its terms, overfitting of one batch, and the same step on several devices."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from ha2g_jax.errors import UserError
from ha2g_jax.methods import seq2seq
from ha2g_jax.methods.seq2seq import continuity, mse, variance
from ha2g_jax.train import sharding
from ha2g_jax.train.objective import init_state
from ha2g_jax.train.step import step_keys, train_step, validation_step

STEPS, SIZE = 150, 16
# Normalising each frame by its batch, in training, lets what differs between two runs grow along the roll-out: at
# debug size a thousandfold, at this one twentyfold.
WIDE = {"model__inferer__hidden_dim": 64, "model__inferer__layers": 2}


def test_terms_by_hand():
    """One clip, two values: one goes from 0 to 3 and 4, the other stays at -1; the true ones stay at 1 and -1."""
    poses, targets = jnp.array([[[0.0, -1.0], [3.0, -1.0], [4.0, -1.0]]]), jnp.array([[[1.0, -1.0]] * 3])
    assert float(mse(poses, targets)) == pytest.approx((1 + 4 + 9) / 6)
    assert float(continuity(poses)) == pytest.approx((3 + 1) / 6)
    assert float(variance(poses)) == pytest.approx(-(5 + np.sqrt(3)) / 6)


def test_variance_of_a_value_at_its_mean_has_a_gradient():
    poses = jnp.zeros((1, 3, 2)).at[:, :, 0].set(2.0)
    gradient = jax.grad(variance)(poses)
    np.testing.assert_allclose(gradient[..., 0], -1 / np.sqrt(3) / 6, rtol=1e-6)
    np.testing.assert_array_equal(gradient[..., 1], 0)


def test_an_identity_is_refused(make_objective):
    with pytest.raises(UserError, match=r"config\.model\.identity\.kind is 'speakers', expected one of none"):
        make_objective("seq2seq", model__identity__kind="speakers")


def test_the_word_table_has_rows_for_the_marks_of_start_and_end(make_objective):
    assert make_objective("seq2seq").spec.generator.num_words == 11 + 2


def test_one_batch_is_learnt_by_heart(make_objective, make_motion_batch, draw_state):
    changes = {"model__inferer__hidden_dim": 16, "train__learning_rate": 1e-2, "train__schedule": "cosine"}
    objective = make_objective("seq2seq", train__steps=STEPS, **changes)
    batch, state, history = make_motion_batch(objective, 4), draw_state(objective), []
    step = jax.jit(functools.partial(train_step, objective), donate_argnums=0)
    for _ in range(STEPS):
        state, metrics = step(state, batch, jax.random.key(1))
        history.append(metrics)
    first, metrics = history[0], history[-1]
    assert metrics["loss/mse"] < 0.03 * first["loss/mse"]
    terms = {name: float(metrics[f"loss/{name}"]) for name in seq2seq.Terms._fields}
    total = 250 * terms["mse"] + 0.1 * terms["continuity"] + 25 * terms["variance"]
    assert float(metrics["loss/total"]) == pytest.approx(total, rel=1e-4)


@pytest.fixture(scope="module")
def make_plain(make_objective):
    """A function from changes to an objective of some width under gradient descent and without dropout."""

    def make(**changes):
        objective = make_objective("seq2seq", model__inferer__dropout=0.0, train__batch_size=SIZE, **WIDE, **changes)
        return dataclasses.replace(objective, generator_optimizer=optax.sgd(1e-4))

    return make


def test_evaluation_is_of_each_clip_by_itself(make_plain, make_motion_batch, draw_state):
    objective = make_plain()
    batch, state = make_motion_batch(objective, 3), draw_state(objective)
    keys = step_keys(objective.spec, jax.random.key(1), state.step)
    run = jax.jit(
        lambda batch: seq2seq.run(objective.spec, state.generator.variables, batch, keys, train=False).outputs.poses[-1]
    )
    single = jax.tree.map(lambda x: x[1:2], batch)
    np.testing.assert_allclose(run(single), run(batch)[1:2], rtol=1e-4, atol=1e-5)
    metrics = jax.jit(functools.partial(validation_step, objective))(state, single, jax.random.key(1))
    assert set(metrics) == {"loss/mse", "loss/continuity", "loss/variance", "loss/total"}
    assert np.isfinite(list(metrics.values())).all()


def test_eight_devices_take_the_step_of_one(make_plain, make_motion_batch):
    objective = make_plain()
    batch = jax.tree.map(np.asarray, make_motion_batch(objective, SIZE))
    start, ends = init_state(objective, jax.random.key(0)), []
    for devices in (jax.devices()[:1], jax.devices()):
        mesh = sharding.data_mesh(devices)
        step = jax.jit(functools.partial(train_step, objective))
        arguments = (sharding.replicate(mesh, start), sharding.shard_batch(mesh, batch), jax.random.key(1))
        ends.append(jax.device_get(step(*arguments)))
    (one, one_metrics), (eight, metrics) = ends
    for name, value in one_metrics.items():
        assert metrics[name] == pytest.approx(value, rel=1e-3), name
    for (path, theirs), ours, before in zip(
        jax.tree.leaves_with_path(one.generator), jax.tree.leaves(eight.generator), jax.tree.leaves(start.generator)
    ):
        moved = np.abs(theirs - before).max()
        tolerance = 1e-2 * moved + 1e-6 * np.abs(theirs).max() + 1e-7
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=tolerance, err_msg=jax.tree_util.keystr(path))
        assert moved > 0, path


def test_half_precision_is_near_single_precision(make_plain, make_motion_batch, draw_state):
    objectives, found = [make_plain(train__dtype=dtype) for dtype in ("float32", "bfloat16")], []
    state = draw_state(objectives[0])
    keys = step_keys(objectives[0].spec, jax.random.key(1), state.step)
    for objective in objectives:

        def loss(params, batch, objective=objective):
            variables = state.generator.variables | {"params": params}
            outputs, _, batch_stats = seq2seq.run(
                objective.spec, variables, batch, keys, train=True, compute=objective.compute
            )
            return jnp.mean(jnp.square(outputs.poses[-1][:, :12])), (outputs.poses[-1], batch_stats)

        found.append(jax.jit(jax.grad(loss, has_aux=True))(state.generator.params, make_motion_batch(objective, SIZE)))
    (gradient, (poses, _)), (half_gradient, (half_poses, batch_stats)) = found
    assert {leaf.dtype for leaf in jax.tree.leaves((half_poses, batch_stats, half_gradient))} == {np.dtype("float32")}
    assert 0 < np.abs(poses - half_poses)[:, :12].max() < 0.03 * np.abs(poses).max()
    distance = optax.tree.norm(jax.tree.map(jnp.subtract, gradient, half_gradient))
    assert distance < 0.1 * optax.tree.norm(gradient)
