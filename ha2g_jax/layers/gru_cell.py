"""Gated recurrent units with the equations of PyTorch.

    r_t = sigmoid(W_r x_t + b_r + U_r h_(t-1) + c_r)
    z_t = sigmoid(W_z x_t + b_z + U_z h_(t-1) + c_z)
    n_t = tanh(W_n x_t + b_n + r_t * (U_n h_(t-1) + c_n))
    h_t = (1 - z_t) * n_t + z_t * h_(t-1)

The second bias c_n lies inside the product with r. The cell of Linen has only one bias and is therefore not used.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp


class Gates(NamedTuple):
    """One array for each gate.

    On a CPU XLA vectorises separate arrays, but not slices of one: the forward pass is 4 times as fast with them.
    """

    reset: jax.Array
    update: jax.Array
    new: jax.Array


def gru_cell(state: jax.Array, gates: Gates, kernels: Gates, bias: jax.Array) -> jax.Array:
    """Return h_t of one GRU from h_(t-1), each (B, h) float32.

    The gates W x_t + b, each (B, h), have c_r and c_z already added; the kernels (h, h) are the transposes of U, and
    the bias (h,) is c_n.
    """
    return _next_state(state, activate(gates, products(state, gates, kernels), bias))


def scan_states(gates: Any, hidden_kernels: Any, hidden_biases: Any, is_real: Any) -> tuple[jax.Array, ...]:
    """Return the states of several GRUs that run side by side, each (N, B, h) float32; see `gru_scan.gru_scan`."""

    def step(states, frame):
        frame, is_real = frame
        after = tuple(
            gru_cell(state, frame_gates, kernels, bias)
            for state, frame_gates, kernels, bias in zip(states, frame, hidden_kernels, hidden_biases, strict=True)
        )
        if is_real is not None:
            after = jax.tree.map(jnp.where, is_real, after, states)
        return after, after

    start = tuple(jnp.zeros_like(gate.reset[0], jnp.float32) for gate in gates)
    return jax.lax.scan(step, start, (gates, is_real))[1]


def sequence_scan(
    gates: Gates, hidden_weight: jax.Array, hidden_bias: jax.Array, is_real: jax.Array | None = None
) -> jax.Array:
    """Run one GRU on a single sequence, from a zero state, as `gru_scan` does for the sequences of a batch.

    With a single row a product takes as long as reading the weights. Here one product reads `hidden_weight` (3 h, h), U
    of the three gates, as it is stored. The kernels of `gru_scan` are copies, which generation would have to make for
    every window. The other arguments and the result are those of one GRU of `gru_scan`.
    """
    dtype = gates.reset.dtype
    weight = hidden_weight.astype(dtype)

    def step(state, frame):
        frame, is_real = frame
        products = Gates(*jnp.split(jnp.einsum("bi,gi->bg", state.astype(dtype), weight), 3, axis=-1))
        after = _next_state(state, activate(frame, products, hidden_bias))
        after = after if is_real is None else jnp.where(is_real, after, state)
        return after, after

    start = jnp.zeros_like(gates.reset[0], jnp.float32)
    return jax.lax.scan(step, start, (gates, is_real))[1].astype(dtype)


def _next_state(state: jax.Array, activations: tuple[jax.Array, ...]) -> jax.Array:
    _, update, _, new = activations
    return new + update * (state - new)


def products(state: jax.Array, gates: Gates, kernels: Gates) -> Gates:
    """Return U h_(t-1) of each gate, each (..., h) of the type of the gates."""
    dtype = gates.reset.dtype
    rounded = state.astype(dtype)
    return Gates(*(rounded @ kernel.astype(dtype) for kernel in kernels))


def activate(gates: Gates, products: Gates, bias: jax.Array) -> tuple[jax.Array, ...]:
    """Return r_t, z_t, U_n h_(t-1) + c_n and n_t, each (..., h) float32."""
    gates, products, bias = float32((gates, products, bias))
    reset = jax.nn.sigmoid(gates.reset + products.reset)
    update = jax.nn.sigmoid(gates.update + products.update)
    inner = products.new + bias.reshape((1,) * (products.new.ndim - 1) + (-1,))
    return reset, update, inner, jnp.tanh(gates.new + reset * inner)


def float32(tree: Any) -> Any:
    """Return a tree of arrays as float32."""
    return jax.tree.map(lambda x: x.astype(jnp.float32), tree)
