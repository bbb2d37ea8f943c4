"""An objective follows its config; the rate follows the step of the run, and a gradient is clipped before Adam."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from ha2g_jax.checkpoint import weights
from ha2g_jax.config import presets
from ha2g_jax.methods import build as build_method
from ha2g_jax.methods.method import restore, subtract_mean
from ha2g_jax.skeleton import load_skeleton
from ha2g_jax.train.inputs import word_table
from ha2g_jax.train.objective import adam, init_state, learning_rate

GRADIENT: Any = {"a": jnp.array([3.0, 0.0]), "b": jnp.array([4.0])}
PARAMS: Any = jax.tree.map(jnp.zeros_like, GRADIENT)


def test_a_speaker_and_the_mirror_image_are_two_rows_of_the_table(config, build):
    assert build(config).spec.generator.identity.num_speakers == 5
    config.data.mirror = 0.5
    assert build(config).spec.generator.identity.num_speakers == 10


def test_word_vectors_start_every_table_of_words():
    config = presets.make("ted_gesture", "debug", "release", {"model.text.embedding_dim": 300})
    spec = build_method(config, load_skeleton("ted_gesture"), 11, 3)
    found = weights.flatten(word_table(spec, np.ones((11, 300), np.float32)))
    assert set(found) == {f"{part}text/embedding/embedding" for part in ("", "pose_1/", "pose_2/", "pose_3/")}


def test_restored_poses_are_the_unit_vectors_that_went_in(objective, make_batch):
    directions = jnp.asarray(make_batch(objective, 2)["directions"])
    poses = subtract_mean(objective.spec, directions)
    assert poses.shape == (2, 34, 27)
    np.testing.assert_allclose(restore(objective.spec, poses), directions, atol=1e-6)
    lengths = jnp.linalg.norm(restore(objective.spec, 2 * poses), axis=-1)
    np.testing.assert_allclose(lengths, 1, atol=1e-6)


def test_a_state_is_a_function_of_the_key(objective):
    first, again, other = (init_state(objective, jax.random.key(seed)) for seed in (0, 0, 1))
    assert first.step == 0
    assert jax.tree.all(jax.tree.map(np.array_equal, first, again))
    assert not jax.tree.all(jax.tree.map(np.array_equal, first.generator.params, other.generator.params))


@pytest.mark.parametrize(("schedule", "expected"), [("constant", [0.2, 0.2, 0.2]), ("cosine", [0.2, 0.1, 0.0])])
def test_the_rate_stays_or_falls_to_zero_at_the_last_step(schedule, expected):
    rate = learning_rate(schedule, 0.2, 10)
    np.testing.assert_allclose(np.array([rate(step) for step in (0, 5, 10)], np.float32), expected, atol=1e-8)


def test_it_is_adam():
    ours: Any = adam((0.5, 0.999))
    theirs: Any = optax.adam(0.1, b1=0.5, b2=0.999)
    state, expected_state = ours.init(PARAMS), theirs.init(PARAMS)
    for scale in (1.0, -0.1):
        gradient = jax.tree.map(lambda x, scale=scale: scale * x, GRADIENT)
        updates, state = ours.update(gradient, state, PARAMS)
        expected, expected_state = theirs.update(gradient, expected_state, PARAMS)
        assert jax.tree.all(jax.tree.map(jnp.array_equal, optax.tree.scale(0.1, updates), expected))


@pytest.mark.parametrize(("clip_norm", "factor"), [(0.0, 1.0), (0.5, 0.1), (7.0, 1.0)])
def test_a_gradient_is_cut_to_the_norm(clip_norm, factor):
    optimizer: Any = adam((0.5, 0.999), clip_norm)
    _, state = optimizer.update(GRADIENT, optimizer.init(PARAMS), PARAMS)
    moments: Any = next(part for part in state if isinstance(part, optax.ScaleByAdamState))
    np.testing.assert_allclose(moments.mu["b"], 0.5 * factor * GRADIENT["b"], rtol=1e-6)
