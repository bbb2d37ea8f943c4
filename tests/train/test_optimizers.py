"""The update of one step: the learning rate follows the step of the run, and the gradient is clipped before Adam."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from ha2g_jax.train.optimizers import adam, learning_rate

GRADIENT: Any = {"a": jnp.array([3.0, 0.0]), "b": jnp.array([4.0])}
PARAMS: Any = jax.tree.map(jnp.zeros_like, GRADIENT)


def update(optimizer: Any, step: int) -> Any:
    """Return the first update and the state after it."""
    return optimizer.update(GRADIENT, optimizer.init(PARAMS), PARAMS, step=jnp.int32(step))


@pytest.mark.parametrize(("schedule", "expected"), [("constant", [0.2, 0.2, 0.2]), ("cosine", [0.2, 0.1, 0.0])])
def test_the_rate_stays_or_falls_to_zero_at_the_last_step(schedule, expected):
    rate = learning_rate(schedule, 0.2, 10)
    np.testing.assert_allclose(np.array([rate(step) for step in (0, 5, 10)], np.float32), expected, atol=1e-8)


def test_it_is_adam():
    ours: Any = adam(learning_rate("constant", 0.1, 1), (0.5, 0.999))
    theirs: Any = optax.adam(0.1, b1=0.5, b2=0.999)
    state, expected_state = ours.init(PARAMS), theirs.init(PARAMS)
    for scale in (1.0, -0.1):
        gradient = jax.tree.map(lambda x, scale=scale: scale * x, GRADIENT)
        updates, state = ours.update(gradient, state, PARAMS, step=jnp.int32(0))
        expected, expected_state = theirs.update(gradient, expected_state, PARAMS)
        assert jax.tree.all(jax.tree.map(jnp.array_equal, updates, expected))


def test_the_step_of_the_run_and_not_the_number_of_updates_sets_the_rate():
    optimizer = adam(learning_rate("cosine", 0.1, 10), (0.5, 0.999))
    (early, _), (late, _) = (update(optimizer, step) for step in (0, 5))
    np.testing.assert_allclose(late["b"], early["b"] / 2, rtol=1e-6)


@pytest.mark.parametrize(("clip_norm", "factor"), [(0.0, 1.0), (0.5, 0.1), (7.0, 1.0)])
def test_a_gradient_is_cut_to_the_norm(clip_norm, factor):
    _, state = update(adam(learning_rate("constant", 0.1, 1), (0.5, 0.999), clip_norm), 0)
    moments: Any = next(part for part in state if isinstance(part, optax.ScaleByAdamState))
    np.testing.assert_allclose(moments.mu["b"], 0.5 * factor * GRADIENT["b"], rtol=1e-6)
