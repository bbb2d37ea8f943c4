"""Trimodal: a second run in other styles; tests/checkpoint/released compares the networks with PyTorch's."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ha2g_jax.methods import trimodal
from ha2g_jax.methods.trimodal import Trimodal
from ha2g_jax.train.step import step_keys


@pytest.fixture(scope="module")
def objective(make_objective):
    return make_objective("trimodal")


@pytest.fixture(scope="module")
def state(objective, draw_state):
    return draw_state(objective)


def keys_of(spec, number):
    return step_keys(spec, jax.random.key(number), jnp.int32(0))


def test_evaluation_compares_with_the_mean_styles_of_a_permutation(objective, state, make_motion_batch):
    batch = make_motion_batch(objective, 5)
    batch["speaker"] = jnp.arange(5)
    evaluate = jax.jit(
        lambda batch, keys: trimodal.run(objective.spec, state.generator.variables, batch, keys, train=False)
    )
    outputs, constants, _ = evaluate(batch, keys_of(objective.spec, 0))
    np.testing.assert_array_equal(constants.z, outputs.mean)
    order = [
        int(np.argmin(np.abs(np.asarray(outputs.mean) - row).max(axis=-1))) for row in np.asarray(constants.other_z)
    ]
    np.testing.assert_array_equal(constants.other_z, outputs.mean[np.array(order)])
    assert sorted(order) == list(range(5)) != order
    other = evaluate(batch | {"speaker": jnp.array(order)}, keys_of(objective.spec, 1))
    np.testing.assert_allclose(constants.poses, other.outputs.poses[-1], atol=1e-6)
    assert not np.allclose(constants.poses, outputs.poses[-1], atol=1e-6)


def test_training_samples_both_styles(objective, state, make_motion_batch):
    """Even a clip that keeps its speaker, such as that of a batch of one, gets another style."""
    batch, keys = make_motion_batch(objective, 1), keys_of(objective.spec, 0)
    outputs, constants, _ = jax.jit(
        lambda: trimodal.run(objective.spec, state.generator.variables, batch, keys, train=True)
    )()
    assert len({tuple(np.asarray(z[0])) for z in (outputs.mean, constants.z, constants.other_z)}) == 3


def test_without_words_the_features_are_those_of_the_sound(make_objective):
    spec = make_objective("trimodal", model__text__kind="none").spec
    assert spec.inputs == ("audio",) and spec.generator.text is None
    encode = functools.partial(spec.generator.init_with_output, train=False, method=Trimodal.encode_speech)
    features, _ = jax.eval_shape(encode, jax.random.key(0), {"audio": jnp.zeros((2, 36_267))})
    assert features.shape[:2] == (2, 34)
