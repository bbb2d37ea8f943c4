"""The one recurrence of the project: a gated recurrent unit with PyTorch's equations.

    r_t = sigmoid(W_r x_t + b_r + U_r h_(t-1) + c_r)
    z_t = sigmoid(W_z x_t + b_z + U_z h_(t-1) + c_z)
    n_t = tanh(W_n x_t + b_n + r_t * (U_n h_(t-1) + c_n))
    h_t = (1 - z_t) * n_t + z_t * h_(t-1)

Rows of the stacked weights are in the order reset r, update z, new n. The second bias c_n lies inside the
product with r, which is why Linen's cell, which has one bias only, is not used.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from flax import linen as nn


class Gates(NamedTuple):
    """One array a gate. A CPU vectorises separate arrays, but not slices of one: 4 times the speed forward."""

    reset: jax.Array
    update: jax.Array
    new: jax.Array


def gru_scan(
    gates: Sequence[Gates], hidden_kernels: Sequence[Gates], hidden_biases: Sequence[jax.Array]
) -> tuple[jax.Array, ...]:
    """Runs independent GRUs side by side in one scan, from a zero state.

    The directions of a bidirectional GRU share the scan, so that it takes N steps and not 2 N. Products are taken
    in the type of the gates, but the state and the kernels' gradients, which add up over the steps, are float32.

    Args:
        gates: per GRU and gate (N, B, h), W x_t + b of every frame, with c_r and c_z already added.
        hidden_kernels: per GRU and gate (h, h), the transpose of U.
        hidden_biases: per GRU (h,), c_n.

    Returns:
        Per GRU (N, B, h), the states h_t.
    """

    def step(states, frame):
        states = tuple(
            _cell(state, frame_gates, kernels, bias)
            for state, frame_gates, kernels, bias in zip(states, frame, hidden_kernels, hidden_biases, strict=True)
        )
        return states, tuple(state.astype(gate.reset.dtype) for state, gate in zip(states, gates, strict=True))

    hidden_kernels, hidden_biases = _float32((tuple(hidden_kernels), tuple(hidden_biases)))
    start = tuple(jnp.zeros_like(gate.reset[0], jnp.float32) for gate in gates)
    return jax.lax.scan(step, start, tuple(gates))[1]


def _cell(state: jax.Array, gates: Gates, kernels: Gates, bias: jax.Array) -> jax.Array:
    dtype = gates.reset.dtype
    gates, rounded = _float32(gates), state.astype(dtype)
    reset = jax.nn.sigmoid(gates.reset + rounded @ kernels.reset.astype(dtype))
    update = jax.nn.sigmoid(gates.update + rounded @ kernels.update.astype(dtype))
    new = jnp.tanh(gates.new + reset * (rounded @ kernels.new.astype(dtype) + bias[None]))
    return new + update * (state - new)


def _float32(tree: Any) -> Any:
    return jax.tree.map(lambda x: x.astype(jnp.float32), tree)


class BiGRU(nn.Module):
    """A bidirectional GRU of several layers whose two directions are summed at the end.

    Between the layers the directions are concatenated, and dropout acts there only. Parameters have the
    names and shapes of `torch.nn.GRU`, such as `weight_ih_l0` (3 h, inputs) and `bias_hh_l1_reverse` (3 h,).

    Attributes:
        hidden_dim: h, values of one direction's state.
        layers: number of layers.
        dropout: rate of the dropout between layers.
    """

    hidden_dim: int
    layers: int
    dropout: float = 0.0

    @nn.compact
    def __call__(self, x: jax.Array, *, train: bool) -> jax.Array:
        """Maps (B, N, inputs) to (B, N, hidden_dim); uses the stream "dropout" in training."""
        x = jnp.swapaxes(x, 0, 1)
        forward = backward = x
        for layer in range(self.layers):
            if layer:
                x = jnp.concatenate([forward, backward], axis=-1)
                x = nn.Dropout(self.dropout)(x, deterministic=not train)
            forward, backward = self._layer(x, layer)
        return jnp.swapaxes(forward + backward, 0, 1)

    def _layer(self, x: jax.Array, layer: int) -> tuple[jax.Array, jax.Array]:
        gates, kernels, bias = self._direction(x, f"_l{layer}")
        back_gates, back_kernels, back_bias = self._direction(x[::-1], f"_l{layer}_reverse")
        forward, backward = gru_scan((gates, back_gates), (kernels, back_kernels), (bias, back_bias))
        return forward, backward[::-1]

    def _direction(self, x: jax.Array, suffix: str) -> tuple[Gates, Gates, jax.Array]:
        width = 3 * self.hidden_dim
        input_weight = self.param("weight_ih" + suffix, self._uniform, (width, x.shape[-1]))
        hidden_weight = self.param("weight_hh" + suffix, self._uniform, (width, self.hidden_dim))
        input_bias = self.param("bias_ih" + suffix, self._uniform, (width,))
        hidden_bias = self.param("bias_hh" + suffix, self._uniform, (width,))
        outside, inside = jnp.split(hidden_bias, [2 * self.hidden_dim])
        bias = input_bias + jnp.concatenate([outside, jnp.zeros_like(inside)])
        # One matrix product for all frames instead of one in each step of the scan.
        gates = jnp.einsum("nbi,gi->nbg", x, input_weight) + bias[None, None]
        kernels = Gates(*jnp.split(hidden_weight.T, 3, axis=-1))
        return Gates(*jnp.split(gates, 3, axis=-1)), kernels, inside

    def _uniform(self, key: jax.Array, shape: tuple[int, ...]) -> jax.Array:
        bound = self.hidden_dim**-0.5
        return jax.random.uniform(key, shape, minval=-bound, maxval=bound)
