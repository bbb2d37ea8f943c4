"""Initial networks: the same key gives the same numbers, and word vectors replace random ones."""

import dataclasses
import functools

import jax
import numpy as np

from ha2g_jax.train.objective import init_state, set_pretrained


def test_state_is_a_function_of_the_key(objective):
    first, again, other = (init_state(objective, jax.random.key(seed)) for seed in (0, 0, 1))
    assert first.step == 0
    assert jax.tree.all(jax.tree.map(np.array_equal, first, again))
    assert not jax.tree.all(jax.tree.map(np.array_equal, first.generator.params, other.generator.params))


def test_an_average_has_the_variables_of_the_generator_and_is_the_model(objective, state):
    assert state.average is None
    assert state.model == state.generator.variables
    averaged = dataclasses.replace(objective, average_decay=0.9)
    start = jax.eval_shape(functools.partial(init_state, averaged), jax.random.key(0))
    assert start.model is start.average
    assert jax.tree.map(np.shape, start.average) == jax.tree.map(np.shape, state.generator.variables)


def test_pretrained_parameters_take_the_place_of_fresh_ones_and_of_no_others(objective, state):
    vectors = np.random.default_rng(0).normal(size=(11, 8)).astype(np.float32)
    part = {"params": {"text": {"embedding": {"embedding": vectors}}}}
    variables = set_pretrained(state.generator.variables, part)
    np.testing.assert_array_equal(variables["params"]["text"]["embedding"]["embedding"], vectors)
    variables["params"]["text"]["embedding"]["embedding"] = state.generator.params["text"]["embedding"]["embedding"]
    assert jax.tree.all(jax.tree.map(np.array_equal, variables, state.generator.variables))
