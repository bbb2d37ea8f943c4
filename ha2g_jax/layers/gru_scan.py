"""Independent GRUs side by side in one scan, with a gradient written by hand.

The states are those of `gru_cell.scan_states`, which has the equations; read that first.
"""

import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ha2g_jax.layers.cpu import onednn
from ha2g_jax.layers.cpu.onednn import library
from ha2g_jax.layers.gru_cell import Gates, activate, float32, products, scan_states


def gru_scan(
    gates: Sequence[Gates],
    hidden_kernels: Sequence[Gates],
    hidden_biases: Sequence[jax.Array],
    is_real: Sequence[jax.Array] | None = None,
) -> tuple[jax.Array, ...]:
    """Run independent GRUs side by side in one scan, from a zero state.

    The directions of a bidirectional GRU share the scan, so that it takes N steps and not 2 N. Products are computed in
    the type of the gates, but the state and the gradients of the kernels, which are summed over the steps, are float32.

    The gradient keeps only the states and computes the gates of all steps from them at once. What is left to its scan
    is the chain from state to state; the gradient of a kernel is one product over all steps. There are gradients of any
    order in reverse mode, but none in forward mode (`jax.jvp`), and within `jax.shard_map` only with `check_vma=False`.

    oneDNN computes both scans where `library.is_used_for` says so, unless there is padding.

    Args:
        gates: for each GRU and gate (N, B, h), W x_t + b of every frame, with c_r and c_z already added.
        hidden_kernels: for each GRU and gate (h, h), the transpose of U.
        hidden_biases: for each GRU (h,), c_n.
        is_real: for each GRU (N, B, 1), False where a step is padding, which does not change the state; None if there
            is no padding.

    Returns:
        For each GRU (N, B, h), the states h_t.
    """
    has_onednn = is_real is None and library.is_used_for(*jax.tree.leaves(gates))
    return _scan(has_onednn, gates, hidden_kernels, hidden_biases, is_real)


@functools.partial(jax.custom_vjp, nondiff_argnums=(0,))
def _scan(has_onednn: bool, gates: Any, hidden_kernels: Any, hidden_biases: Any, is_real: Any) -> tuple[jax.Array, ...]:
    return _run(has_onednn, gates, hidden_kernels, hidden_biases, is_real)[0]


def _run(
    has_onednn: bool, gates: Any, hidden_kernels: Any, hidden_biases: Any, is_real: Any
) -> tuple[tuple[jax.Array, ...], Any]:
    """Return the states as `gru_scan` does, and what its gradient needs: the arguments and the states in float32."""
    arguments = (gates, hidden_kernels, hidden_biases, is_real)
    hidden_kernels, hidden_biases = float32((tuple(hidden_kernels), tuple(hidden_biases)))
    if has_onednn:
        states = tuple(map(_onednn_states, gates, hidden_kernels, hidden_biases))
    else:
        states = scan_states(tuple(gates), hidden_kernels, hidden_biases, None if is_real is None else tuple(is_real))
    return tuple(it.astype(gate.reset.dtype) for it, gate in zip(states, gates, strict=True)), (arguments, states)


_onednn_states = onednn.differentiated_as(
    lambda gates, kernels, bias: scan_states((gates,), (kernels,), (bias,), None)[0], onednn.gru_states
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
    reset, update, inner, new = activate(gates, products(before, gates, kernels), bias)
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


def _pull_back(has_onednn: bool, residuals: Any, cotangents: tuple[jax.Array, ...]) -> tuple[Any, ...]:
    """Return the gradients of the arguments of `gru_scan`."""
    (gates, hidden_kernels, hidden_biases, is_real), states = residuals
    before = tuple(jnp.concatenate([jnp.zeros_like(it[:1]), it[:-1]]) for it in states)
    masks = (None,) * len(gates) if is_real is None else is_real
    slopes = tuple(map(_slopes, before, gates, hidden_kernels, hidden_biases, masks))

    cotangents = float32(tuple(cotangents))
    if has_onednn:
        sums = tuple(map(_onednn_sums, cotangents, slopes, float32(tuple(hidden_kernels))))
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


_onednn_sums = onednn.differentiated_as(
    lambda cotangents, slopes, kernels: _sums((cotangents,), (slopes,), (kernels,), jnp.float32)[0],
    lambda cotangents, slopes, kernels: Gates(*onednn.gru_sums(cotangents, slopes, kernels)),
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
    reset, update, new = float32(chained)
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


_scan.defvjp(_run, _pull_back)
