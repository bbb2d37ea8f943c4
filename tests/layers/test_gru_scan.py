"""The gradient of the recurrence is that of its steps."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ha2g_jax.layers.cpu.recurrence import gru_scan
from ha2g_jax.layers.gru_cell import Gates, gru_cell


@pytest.mark.parametrize("is_padded", [False, True])
def test_gradients_of_both_orders_are_those_of_the_steps(oracles, is_padded):
    rng = np.random.default_rng(0)
    draw = lambda *shape: Gates(*rng.normal(size=(3, *shape)).astype(np.float32))  # noqa: E731
    gates, kernels, bias = draw(4, 3, 5), draw(5, 5), rng.normal(size=5).astype(np.float32)
    is_real = np.arange(4)[:, None, None] < np.array([4, 2, 1])[:, None] if is_padded else np.ones((4, 3, 1), bool)

    def scanned(arguments):
        gates, kernels, bias = arguments
        (states,) = gru_scan((gates,), (kernels,), (bias,), (is_real,) if is_padded else None)
        return jnp.sum(jnp.sin(states))

    def stepped(arguments):
        (gates, kernels, bias), state, total = arguments, jnp.zeros((3, 5)), 0.0
        for number in range(4):
            after = gru_cell(state, Gates(*(gate[number] for gate in gates)), kernels, bias)
            state = jnp.where(is_real[number], after, state)
            total += jnp.sum(jnp.sin(state))
        return total

    def second(function):
        return jax.grad(lambda it: sum(jnp.sum(leaf**2) for leaf in jax.tree.leaves(jax.grad(function)(it))))

    arguments = (gates, kernels, bias)
    for of in (jax.grad, second):
        oracles.assert_close(jax.jit(of(scanned))(arguments), jax.jit(of(stepped))(arguments))
