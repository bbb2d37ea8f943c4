"""Speech2Gesture: its terms, overfitting of one batch, and the same step on several devices."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from ha2g_jax.errors import UserError
from ha2g_jax.methods import speech2gesture
from ha2g_jax.methods.adversarial import discriminate
from ha2g_jax.methods.speech2gesture import l1
from ha2g_jax.train import sharding
from ha2g_jax.train.step import step_keys, train_step, validation_step

STEPS, SIZE = 75, 16
# Fewer layers than the paper's, which take long to compile.
SHALLOW = {"model__audio__channels": (4,), "model__inferer__layers": 1, "model__inferer__hidden_dim": 16}


@pytest.fixture(scope="module")
def make_plain(make_objective):
    """A function from changes to an objective of few layers under gradient descent."""

    def make(**changes):
        objective = make_objective("speech2gesture", train__batch_size=SIZE, **(SHALLOW | changes))
        sgd = {"generator_optimizer": optax.sgd(1e-4), "discriminator_optimizer": optax.sgd(1e-2)}
        return dataclasses.replace(objective, **sgd)

    return make


def test_l1_is_the_mean_over_all_frames():
    poses, targets = jnp.array([[[0.0, -1.0], [3.0, -1.0]]]), jnp.array([[[1.0, -1.0], [1.0, -2.0]]])
    assert float(l1(poses, targets)) == pytest.approx((1 + 0 + 2 + 1) / 4)


def test_an_identity_is_refused(make_objective):
    with pytest.raises(UserError, match=r"config\.model\.identity\.kind is 'images', expected one of none"):
        make_objective("speech2gesture", model__identity__kind="images")


def test_legacy_trains_as_the_published_comparison_did(make_objective, make_motion_batch, draw_state):
    """A step with the same parameters takes another input and has another discriminator."""
    objectives = [make_objective("speech2gesture", model__legacy=legacy, **SHALLOW) for legacy in (False, True)]
    assert [objective.spec.generator.swapped_axes for objective in objectives] == [False, True]
    assert [objective.spec.discriminator.differences for objective in objectives] == [1, 2]
    state, batch = draw_state(objectives[0]), make_motion_batch(objectives[0], 3)
    steps = [jax.jit(functools.partial(train_step, objective)) for objective in objectives]
    new, legacy = (step(state, batch, jax.random.key(1))[1] for step in steps)
    for name in ("loss/l1", "loss/discriminator"):
        assert jnp.isfinite(legacy[name]) and legacy[name] != pytest.approx(float(new[name]), rel=1e-3)


def test_one_batch_is_learnt_by_heart_against_the_adversary(make_objective, make_motion_batch, draw_state):
    changes = {"model__inferer__hidden_dim": 32, "train__learning_rate": 1e-2, "train__schedule": "cosine"}
    objective = make_objective("speech2gesture", train__steps=STEPS, **(SHALLOW | changes))
    assert objective.warmup_steps == 0
    batch, state, history = make_motion_batch(objective, 4), draw_state(objective), []
    before = jax.tree.map(np.asarray, state.discriminator.params)
    step = jax.jit(functools.partial(train_step, objective))
    for number in range(STEPS):
        state, metrics = step(state, batch, jax.random.key(1))
        history.append(metrics)
        if not number:  # the adversary trains from the first step
            kernels = [params["conv_in"]["kernel"] for params in (state.discriminator.params, before)]
            assert np.abs(kernels[0] - kernels[1]).max() > 0
    first, metrics = history[0], history[-1]
    assert metrics["loss/l1"] < 0.1 * first["loss/l1"]
    total = 100 * float(metrics["loss/l1"]) + 10 * float(metrics["loss/gan"])
    assert float(metrics["loss/total"]) == pytest.approx(total, rel=1e-4)


def test_evaluation_takes_a_single_clip_and_the_mean_square_of_its_scores(make_plain, make_motion_batch, draw_state):
    objective = make_plain()
    batch, state = make_motion_batch(objective, 3), draw_state(objective)
    keys = step_keys(objective.spec, jax.random.key(1), state.step)

    @jax.jit
    def run(batch):
        poses = speech2gesture.run(objective.spec, state.generator.variables, batch, keys, train=False).outputs.poses[
            -1
        ]
        scores, _ = discriminate(objective.spec, state.discriminator.variables, poses, keys["gan"], train=False)
        return poses, scores

    single = jax.tree.map(lambda x: x[1:2], batch)
    poses, scores = run(single)
    np.testing.assert_allclose(poses, run(batch)[0][1:2], rtol=1e-4, atol=1e-5)
    assert scores.shape == (1, 9)
    metrics = jax.jit(functools.partial(validation_step, objective))(state, single, jax.random.key(1))
    assert float(metrics["loss/gan"]) == pytest.approx(np.mean((1 - np.asarray(scores)) ** 2), rel=1e-4)


def test_eight_devices_take_the_step_of_one(make_plain, make_motion_batch, draw_state):
    objective = make_plain()
    batch = jax.tree.map(np.asarray, make_motion_batch(objective, SIZE))
    start, ends = draw_state(objective), []
    for devices in (jax.devices()[:1], jax.devices()):
        mesh = sharding.data_mesh(devices)
        step = jax.jit(functools.partial(train_step, objective))
        arguments = (sharding.replicate(mesh, start), sharding.shard_batch(mesh, batch), jax.random.key(1))
        ends.append(jax.device_get(step(*arguments)))
    (one, one_metrics), (eight, metrics) = ends
    for name, value in one_metrics.items():
        assert metrics[name] == pytest.approx(value, rel=1e-3), name
    trees = [(state.generator, state.discriminator) for state in (one, eight, start)]
    leaves = zip(jax.tree.leaves_with_path(trees[0]), *map(jax.tree.leaves, trees[1:]), strict=True)
    for (path, theirs), ours, before in leaves:
        # Biases right before a BatchNorm move by rounding alone.
        tolerance = 1e-2 * np.abs(theirs - before).max() + 1e-6 * np.abs(theirs).max() + 1e-7
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=tolerance, err_msg=jax.tree_util.keystr(path))


def test_half_precision_is_near_single_precision(make_plain, make_motion_batch, draw_state):
    objectives, found = [make_plain(train__dtype=dtype) for dtype in ("float32", "bfloat16")], []
    state = draw_state(objectives[0])
    keys = step_keys(objectives[0].spec, jax.random.key(1), state.step)
    for objective in objectives:

        def loss(params, batch, objective=objective):
            variables = state.generator.variables | {"params": params}
            outputs, _, batch_stats = speech2gesture.run(
                objective.spec, variables, batch, keys, train=True, compute=objective.compute
            )
            return jnp.mean(jnp.square(outputs.poses[-1])), (outputs.poses[-1], batch_stats)

        found.append(jax.jit(jax.grad(loss, has_aux=True))(state.generator.params, make_motion_batch(objective, SIZE)))
    (gradient, (poses, _)), (half_gradient, (half_poses, batch_stats)) = found
    assert {leaf.dtype for leaf in jax.tree.leaves((half_poses, batch_stats, half_gradient))} == {np.dtype("float32")}
    assert 0 < np.std(poses - half_poses) < 0.05 * np.std(poses)
    # Rounding grows from layer to layer, more so for the speech of this batch, which is noise.
    distance = optax.tree.norm(jax.tree.map(jnp.subtract, gradient, half_gradient))
    assert distance < 0.3 * optax.tree.norm(gradient)
