"""The recurrence of gated recurrent units, with the equations of PyTorch, and its gradient.

    r_t = sigmoid(W_r x_t + b_r + U_r h_(t-1) + c_r)
    z_t = sigmoid(W_z x_t + b_z + U_z h_(t-1) + c_z)
    n_t = tanh(W_n x_t + b_n + r_t * (U_n h_(t-1) + c_n))
    h_t = (1 - z_t) * n_t + z_t * h_(t-1)

The second bias c_n lies inside the product with r. The cell of Linen has only one bias and is therefore not used.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ha2g_jax.layers.cpu.onednn import calls, library


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

    With the extra `ha2g-jax[onednn]`, training computes both scans with oneDNN (`onednn`), unless there is padding.

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


def _run(gates: Any, hidden_kernels: Any, hidden_biases: Any, is_real: Any) -> tuple[tuple[jax.Array, ...], Any]:
    """Return the states as `gru_scan` does, and what its gradient needs: the arguments and the states in float32."""
    arguments = (gates, hidden_kernels, hidden_biases, is_real)
    hidden_kernels, hidden_biases = _float32((tuple(hidden_kernels), tuple(hidden_biases)))
    if is_real is None and library.is_used_for(*jax.tree.leaves(gates)):
        states = tuple(map(_onednn_states, gates, hidden_kernels, hidden_biases))
    else:
        states = _states(tuple(gates), hidden_kernels, hidden_biases, None if is_real is None else tuple(is_real))
    return tuple(it.astype(gate.reset.dtype) for it, gate in zip(states, gates, strict=True)), (arguments, states)


def _states(gates: Any, hidden_kernels: Any, hidden_biases: Any, is_real: Any) -> tuple[jax.Array, ...]:
    """Return the states of all GRUs, each (N, B, h) float32."""

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


_onednn_states = calls.differentiated_as(
    lambda gates, kernels, bias: _states((gates,), (kernels,), (bias,), None)[0], calls.gru_states
)


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
    reset, update, inner, new = _activations(gates, _products(before, gates, kernels), bias)
    slopes = _Slopes(
        new=(1 - update) * (1 - new**2),
        update=(before - new) * update * (1 - update),
        reset=inner * reset * (1 - reset),
        inner=reset,
        kept=update,
    )
    if is_real is None:
        return slopes
    slopes = jax.tree.map(lambda slope: jnp.where(is_real, slope, 0.0), slopes)
    return slopes._replace(kept=jnp.where(is_real, update, 1.0))


def _pull_back(residuals: Any, cotangents: tuple[jax.Array, ...]) -> tuple[Any, ...]:
    """Return the gradients of the arguments of `gru_scan`."""
    (gates, hidden_kernels, hidden_biases, is_real), states = residuals
    before = tuple(jnp.concatenate([jnp.zeros_like(it[:1]), it[:-1]]) for it in states)
    masks = (None,) * len(gates) if is_real is None else is_real
    slopes = tuple(map(_slopes, before, gates, hidden_kernels, hidden_biases, masks))

    cotangents = _float32(tuple(cotangents))
    if is_real is None and library.is_used_for(*jax.tree.leaves(gates)):
        sums = tuple(map(_onednn_sums, cotangents, slopes, _float32(tuple(hidden_kernels))))
    else:
        sums = _sums(cotangents, slopes, hidden_kernels, gates[0].reset.dtype)
    of_gates = jax.tree.map(lambda it, gate: it.astype(gate.dtype), sums, tuple(gates))
    parts = tuple(map(_kernel_gradients, before, sums, slopes, hidden_kernels, gates))
    return of_gates, tuple(kernels for kernels, _ in parts), tuple(biases for _, biases in parts), None


def _sums(cotangents: Any, slopes: Any, kernels: Any, dtype: Any) -> tuple[Gates, ...]:
    """Return the gradients of the three sums of all steps, for each GRU and sum (N, B, h) float32."""

    def step(after, frame):
        found = tuple(
            _step_back(state, cotangent, slope, kernel, dtype)
            for state, cotangent, slope, kernel in zip(after, *frame, kernels, strict=True)
        )
        return tuple(state for state, _ in found), tuple(gradient for _, gradient in found)

    start = tuple(jnp.zeros_like(it[0]) for it in cotangents)
    return jax.lax.scan(step, start, (cotangents, slopes), reverse=True)[1]


_onednn_sums = calls.differentiated_as(
    lambda cotangents, slopes, kernels: _sums((cotangents,), (slopes,), (kernels,), jnp.float32)[0],
    lambda cotangents, slopes, kernels: Gates(*calls.gru_sums(cotangents, slopes, kernels)),
)


def _step_back(
    after: jax.Array, cotangent: jax.Array, slopes: _Slopes, kernels: Gates, dtype: Any
) -> tuple[jax.Array, Gates]:
    """Return the gradient of h_(t-1) and those of the three sums of step t, from that of h_t by the steps after t."""
    after = after + cotangent
    new, update = after * slopes.new, after * slopes.update
    sums = Gates(new * slopes.reset, update, new)
    inner = sums._replace(new=new * slopes.inner)
    chained = Gates(*(it.astype(dtype) @ kernel.T.astype(dtype) for it, kernel in zip(inner, kernels, strict=True)))
    reset, update, new = _float32(chained)
    return after * slopes.kept + reset + update + new, sums


def _kernel_gradients(
    before: jax.Array, sums: Gates, slopes: _Slopes, kernels: Gates, gates: Gates
) -> tuple[Gates, jax.Array]:
    """Return the gradients of the hidden kernels and of c_n of one GRU, each summed over all steps in float32."""
    inner, dtype = sums._replace(new=sums.new * slopes.inner), gates.reset.dtype
    rounded = before.astype(dtype)
    products = jax.tree.map(
        lambda it: jnp.einsum("nbi,nbj->ij", rounded, it.astype(dtype), preferred_element_type=jnp.float32), inner
    )
    like = kernels.new.dtype
    return jax.tree.map(lambda it: it.astype(like), products), jnp.sum(inner.new, (0, 1)).astype(like)


gru_scan.defvjp(_run, _pull_back)


def sequence_scan(
    gates: Gates, hidden_weight: jax.Array, hidden_bias: jax.Array, is_real: jax.Array | None = None
) -> jax.Array:
    """Run one GRU on a single sequence, from a zero state, as `gru_scan` does for the sequences of a batch.

    With a single row a product takes as long as reading the weights. One product reads them as they are stored, whereas
    the kernels of `gru_scan` are copies, which generation would make anew for every window.

    Args:
        gates: for each gate (N, 1, h), W x_t + b of every frame, with c_r and c_z already added.
        hidden_weight: (3 h, h), U of the three gates.
        hidden_bias: (h,), c_n.
        is_real: (N, 1, 1), False where a step is padding, which does not change the state; None if there is no padding.

    Returns:
        (N, 1, h), the states h_t.
    """
    dtype = gates.reset.dtype
    weight = hidden_weight.astype(dtype)

    def step(state, frame):
        frame, is_real = frame
        products = Gates(*jnp.split(jnp.einsum("bi,gi->bg", state.astype(dtype), weight), 3, axis=-1))
        after = _next_state(state, _activations(frame, products, hidden_bias))
        after = after if is_real is None else jnp.where(is_real, after, state)
        return after, after

    start = jnp.zeros_like(gates.reset[0], jnp.float32)
    return jax.lax.scan(step, start, (gates, is_real))[1].astype(dtype)


def gru_cell(state: jax.Array, gates: Gates, kernels: Gates, bias: jax.Array) -> jax.Array:
    """Compute one step of one GRU.

    Args:
        state: (B, h) float32, h_(t-1).
        gates: for each gate (B, h), W x_t + b, with c_r and c_z already added.
        kernels: for each gate (h, h), the transpose of U.
        bias: (h,), c_n.

    Returns:
        (B, h) float32, h_t.
    """
    return _next_state(state, _activations(gates, _products(state, gates, kernels), bias))


def _next_state(state: jax.Array, activations: tuple[jax.Array, ...]) -> jax.Array:
    _, update, _, new = activations
    return new + update * (state - new)


def _products(state: jax.Array, gates: Gates, kernels: Gates) -> Gates:
    """Return U h_(t-1) of each gate, each (..., h) of the type of the gates."""
    dtype = gates.reset.dtype
    rounded = state.astype(dtype)
    return Gates(*(rounded @ kernel.astype(dtype) for kernel in kernels))


def _activations(gates: Gates, products: Gates, bias: jax.Array) -> tuple[jax.Array, ...]:
    """Return r_t, z_t, U_n h_(t-1) + c_n and n_t, each (..., h) float32."""
    gates = _float32(gates)
    reset = jax.nn.sigmoid(gates.reset + products.reset)
    update = jax.nn.sigmoid(gates.update + products.update)
    inner = products.new + bias.reshape((1,) * (products.new.ndim - 1) + (-1,))
    return reset, update, inner, jnp.tanh(gates.new + reset * inner)


def _float32(tree: Any) -> Any:
    return jax.tree.map(lambda x: x.astype(jnp.float32), tree)
