"""Gated recurrent units with the equations of PyTorch, the only recurrence of the project.

    r_t = sigmoid(W_r x_t + b_r + U_r h_(t-1) + c_r)
    z_t = sigmoid(W_z x_t + b_z + U_z h_(t-1) + c_z)
    n_t = tanh(W_n x_t + b_n + r_t * (U_n h_(t-1) + c_n))
    h_t = (1 - z_t) * n_t + z_t * h_(t-1)

Rows of the stacked weights are in the order reset r, update z, new n. The second bias c_n lies inside the
product with r. The cell of Linen has only one bias and is therefore not used.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from flax import linen as nn

from ha2g_jax.layers import initializers


class Gates(NamedTuple):
    """One array for each gate. A CPU vectorises separate arrays but not slices of one: 4 times the speed forward."""

    reset: jax.Array
    update: jax.Array
    new: jax.Array


@jax.custom_vjp
def gru_scan(
    gates: Sequence[Gates],
    hidden_kernels: Sequence[Gates],
    hidden_biases: Sequence[jax.Array],
    is_real: Sequence[jax.Array] | None = None,
) -> tuple[jax.Array, ...]:
    """Run independent GRUs side by side in one scan, from a zero state.

    The directions of a bidirectional GRU share the scan, so that it takes N steps and not 2 N. Products are computed in
    the type of the gates, but the state and the gradients of the kernels, which are summed over the steps, are float32.

    The gradient keeps the states alone and computes the gates of all steps from them at once. What is left to its scan
    is the chain from state to state; the gradient of a kernel is one product over all steps. There are gradients of any
    order in reverse mode, but none in forward mode (`jax.jvp`).

    Args:
        gates: for each GRU and gate (N, B, h), W x_t + b of every frame, with c_r and c_z already added.
        hidden_kernels: for each GRU and gate (h, h), the transpose of U.
        hidden_biases: for each GRU (h,), c_n.
        is_real: for each GRU (N, B, 1), False where a step is padding, which does not change the state; None if there
            is no padding.

    Returns:
        For each GRU (N, B, h), the states h_t.
    """
    return _run(gates, hidden_kernels, hidden_biases, is_real)[0]


def _run(gates, hidden_kernels, hidden_biases, is_real):
    """Return the states as `gru_scan` does, and what its gradient needs: the arguments and the states in float32."""

    def step(states, frame):
        frame, is_real = frame
        after = tuple(
            _cell(state, frame_gates, kernels, bias)
            for state, frame_gates, kernels, bias in zip(states, frame, hidden_kernels, hidden_biases, strict=True)
        )
        if is_real is not None:
            after = jax.tree.map(jnp.where, is_real, after, states)
        return after, after

    arguments = (gates, hidden_kernels, hidden_biases, is_real)
    hidden_kernels, hidden_biases = _float32((tuple(hidden_kernels), tuple(hidden_biases)))
    start = tuple(jnp.zeros_like(gate.reset[0], jnp.float32) for gate in gates)
    states = jax.lax.scan(step, start, (tuple(gates), None if is_real is None else tuple(is_real)))[1]
    return tuple(it.astype(gate.reset.dtype) for it, gate in zip(states, gates, strict=True)), (arguments, states)


class _Slopes(NamedTuple):
    """Factors of the chain from the gradient d of h_t, each (N, B, h) float32.

    Attributes:
        new: gradient of the sum inside tanh over d.
        update: gradient of the sum inside the sigmoid of z over d.
        reset: gradient of the sum inside the sigmoid of r over that inside tanh.
        inner: r, the gradient of U_n h + c_n over that of the sum inside tanh.
        kept: z, the part of d that reaches h_(t-1) directly.
    """

    new: jax.Array
    update: jax.Array
    reset: jax.Array
    inner: jax.Array
    kept: jax.Array


def _slopes(before: jax.Array, gates: Gates, kernels: Gates, bias: jax.Array, is_real: jax.Array | None) -> _Slopes:
    """Return the factors of all steps from the states before each step (N, B, h); a step of padding keeps all of d."""
    reset, update, inner, new = _activations(before, gates, kernels, bias)
    slopes = _Slopes(
        new=(1 - update) * (1 - new**2),
        update=(before - new) * update * (1 - update),
        reset=inner * reset * (1 - reset),
        inner=reset,
        kept=update,
    )
    if is_real is None:
        return slopes
    padding = _Slopes(0.0, 0.0, 0.0, 0.0, 1.0)
    return jax.tree.map(lambda slope, there: jnp.where(is_real, slope, there), slopes, padding)


def _pull_back(residuals, cotangents):
    """Return the gradients of the arguments of `gru_scan`."""
    (gates, hidden_kernels, hidden_biases, is_real), states = residuals
    befores = tuple(jnp.concatenate([jnp.zeros_like(it[:1]), it[:-1]]) for it in states)
    masks = (None,) * len(gates) if is_real is None else is_real
    slopes = tuple(map(_slopes, befores, gates, hidden_kernels, hidden_biases, masks))
    rounded = [
        jax.tree.map(lambda it, dtype=gate.reset.dtype: it.astype(dtype), kernels)
        for kernels, gate in zip(hidden_kernels, gates, strict=True)
    ]

    def step(after, frame):
        found = tuple(map(_step_back, after, *frame, rounded))
        return tuple(before for before, _ in found), tuple(gradient for _, gradient in found)

    start = tuple(jnp.zeros_like(it[0]) for it in states)
    _, sums = jax.lax.scan(step, start, (_float32(tuple(cotangents)), slopes), reverse=True)
    of_kernels, of_biases = [], []
    for before, gradient, slope, gate, kernels, bias in zip(
        befores, sums, slopes, gates, hidden_kernels, hidden_biases, strict=True
    ):
        inner = gradient._replace(new=gradient.new * slope.inner)
        dtype = gate.reset.dtype
        products = (
            jnp.einsum("nbi,nbj->ij", before.astype(dtype), it.astype(dtype), preferred_element_type=jnp.float32)
            for it in inner
        )
        of_kernels.append(Gates(*(it.astype(kernel.dtype) for it, kernel in zip(products, kernels, strict=True))))
        of_biases.append(jnp.sum(inner.new, (0, 1)).astype(bias.dtype))
    of_gates = [Gates(*(it.astype(gate.reset.dtype) for it in gradient)) for gradient, gate in zip(sums, gates)]
    return type(gates)(of_gates), type(hidden_kernels)(of_kernels), type(hidden_biases)(of_biases), None


def _step_back(after: jax.Array, cotangent: jax.Array, slopes: _Slopes, kernels: Gates) -> tuple[jax.Array, Gates]:
    """Return the gradient of h_(t-1) and those of the three sums of step t, from that of h_t by the steps after t."""
    after = after + cotangent
    new, update = after * slopes.new, after * slopes.update
    sums = Gates(new * slopes.reset, update, new)
    dtype = kernels.reset.dtype
    inner = sums._replace(new=new * slopes.inner)
    chained = _float32(Gates(*(it.astype(dtype) @ kernel.T for it, kernel in zip(inner, kernels, strict=True))))
    return after * slopes.kept + chained.reset + chained.update + chained.new, sums


gru_scan.defvjp(_run, _pull_back)


def _cell(state: jax.Array, gates: Gates, kernels: Gates, bias: jax.Array) -> jax.Array:
    """Return h_t from h_(t-1), (..., h) float32."""
    _, update, _, new = _activations(state, gates, kernels, bias)
    return new + update * (state - new)


def _activations(state: jax.Array, gates: Gates, kernels: Gates, bias: jax.Array) -> tuple[jax.Array, ...]:
    """Return r_t, z_t, U_n h_(t-1) + c_n and n_t, each (..., h) float32."""
    dtype = gates.reset.dtype
    gates, rounded = _float32(gates), state.astype(dtype)
    reset = jax.nn.sigmoid(gates.reset + rounded @ kernels.reset.astype(dtype))
    update = jax.nn.sigmoid(gates.update + rounded @ kernels.update.astype(dtype))
    inner = rounded @ kernels.new.astype(dtype) + bias.reshape((1,) * (state.ndim - 1) + (-1,))
    return reset, update, inner, jnp.tanh(gates.new + reset * inner)


def _float32(tree: Any) -> Any:
    return jax.tree.map(lambda x: x.astype(jnp.float32), tree)


def _weights(module: nn.Module, inputs: int, hidden_dim: int, suffix: str) -> tuple[jax.Array, ...]:
    """Return the parameters of one GRU in a module, named as in `torch.nn.GRU`; they start uniform in +-1/sqrt(h)."""
    uniform, width = initializers.uniform(hidden_dim**-0.5), 3 * hidden_dim
    return (
        module.param("weight_ih" + suffix, uniform, (width, inputs)),
        module.param("weight_hh" + suffix, uniform, (width, hidden_dim)),
        module.param("bias_ih" + suffix, uniform, (width,)),
        module.param("bias_hh" + suffix, uniform, (width,)),
    )


def _prepare(x: jax.Array, weights: tuple[jax.Array, ...]) -> tuple[Gates, Gates, jax.Array]:
    """Return the gates, hidden kernels and hidden bias of one GRU on x (N, B, inputs), as `gru_scan` takes them."""
    input_weight, hidden_weight, input_bias, hidden_bias = weights
    outside, inside = jnp.split(hidden_bias, [2 * hidden_weight.shape[1]])
    bias = input_bias + jnp.concatenate([outside, jnp.zeros_like(inside)])
    # One matrix product for all frames instead of one in each step of the scan.
    gates = jnp.einsum("nbi,gi->nbg", x, input_weight) + bias[None, None]
    kernels = Gates(*jnp.split(hidden_weight.T, 3, axis=-1))
    return Gates(*jnp.split(gates, 3, axis=-1)), kernels, inside


class BiGRU(nn.Module):
    """A bidirectional GRU of several layers whose two directions are summed at the end.

    Between the layers the directions are concatenated, and dropout acts only there. Parameters have the names and
    shapes of `torch.nn.GRU`, such as `weight_ih_l0` (3 h, inputs) and `bias_hh_l1_reverse` (3 h,).

    Attributes:
        hidden_dim: number of values of the state of one direction, h.
        layers: number of layers.
        dropout: dropout rate between the layers.
    """

    hidden_dim: int
    layers: int
    dropout: float = 0.0

    def __call__(self, x: jax.Array, *, train: bool) -> jax.Array:
        """Map (B, N, inputs) to (B, N, hidden_dim); uses the stream "dropout" in training."""
        forward, backward = self.states(x, train=train)[-1]
        return forward + backward

    @nn.compact
    def states(
        self, x: jax.Array, *, is_real: jax.Array | None = None, train: bool
    ) -> tuple[tuple[jax.Array, jax.Array], ...]:
        """Return the states of every layer, for sequences that may end early.

        Args:
            x: (B, N, inputs) input of every step.
            is_real: (B, N), False at steps after the end of a sequence. There the forward state does not change, so
                that the last one is the final state, and the backward state is 0.
            train: whether to run in training mode, which uses the random stream "dropout".

        Returns:
            For each layer the forward and the backward states, each (B, N, hidden_dim).
        """
        x = jnp.swapaxes(x, 0, 1)
        if is_real is not None:
            is_real = is_real.T[..., None]
        layers: list[tuple[jax.Array, jax.Array]] = []
        for layer in range(self.layers):
            if layer:
                x = jnp.concatenate(layers[-1], axis=-1)
                x = nn.Dropout(self.dropout)(x, deterministic=not train)
            layers.append(self._layer(x, is_real, layer))
        return tuple((jnp.swapaxes(forward, 0, 1), jnp.swapaxes(backward, 0, 1)) for forward, backward in layers)

    def _layer(self, x: jax.Array, is_real: jax.Array | None, layer: int) -> tuple[jax.Array, jax.Array]:
        weights, back_weights = (
            _weights(self, x.shape[-1], self.hidden_dim, f"_l{layer}{suffix}") for suffix in ("", "_reverse")
        )
        gates, kernels, bias = _prepare(x, weights)
        back_gates, back_kernels, back_bias = _prepare(x[::-1], back_weights)
        forward, backward = gru_scan(
            (gates, back_gates),
            (kernels, back_kernels),
            (bias, back_bias),
            None if is_real is None else (is_real, is_real[::-1]),
        )
        return forward, backward[::-1]


class GRU(nn.Module):
    """A GRU of several layers that runs forward in time, without dropout and with the parameters of `torch.nn.GRU`.

    Attributes:
        hidden_dim: number of values of a state, h.
        layers: number of layers.
    """

    hidden_dim: int
    layers: int

    @nn.compact
    def __call__(self, x: jax.Array) -> jax.Array:
        """Map (B, N, inputs) to the states of the last layer, (B, N, hidden_dim)."""
        x = jnp.swapaxes(x, 0, 1)
        for layer in range(self.layers):
            gates, kernels, bias = _prepare(x, _weights(self, x.shape[-1], self.hidden_dim, f"_l{layer}"))
            (x,) = gru_scan((gates,), (kernels,), (bias,))
        return jnp.swapaxes(x, 0, 1)


class GRUCells(nn.Module):
    """One step of a GRU of several layers that runs forward in time, with the parameters of `torch.nn.GRU`.

    Attributes:
        hidden_dim: number of values of a state, h.
        layers: number of layers.
        dropout: dropout rate between the layers.
    """

    hidden_dim: int
    layers: int
    dropout: float = 0.0

    @nn.compact
    def __call__(self, states: tuple[jax.Array, ...], x: jax.Array, *, train: bool) -> tuple[jax.Array, ...]:
        """Return the states h_t of one step; training uses the random stream "dropout".

        Args:
            states: h_(t-1), for each layer (B, hidden_dim) float32.
            x: (B, inputs) input x_t.
            train: whether to run in training mode.
        """
        after: list[jax.Array] = []
        for layer, state in enumerate(states):
            if layer:
                x = nn.Dropout(self.dropout)(after[-1].astype(x.dtype), deterministic=not train)
            weights = _weights(self, x.shape[-1], self.hidden_dim, f"_l{layer}")
            gates, kernels, bias = _prepare(x[None], weights)
            after.append(_cell(state, jax.tree.map(lambda gate: gate[0], gates), kernels, bias))
        return tuple(after)
