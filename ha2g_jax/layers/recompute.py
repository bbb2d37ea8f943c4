"""Recompute activations in the backward pass, which takes less memory and more arithmetic."""

import jax
from flax import linen as nn


def run(block: nn.Module, x: jax.Array, *, train: bool, is_recomputed: bool, method: str = "__call__") -> jax.Array:
    """Run a module; if `is_recomputed`, keep only its input for the gradient and compute the activations again.

    This is meant for modules with BatchNorm over the whole batch, which cannot take the batch in parts. On CPUs it
    saves no memory, because XLA merges the second computation with the first.

    Args:
        block: module.
        x: input of the method.
        train: whether to run in training mode.
        is_recomputed: whether to compute the activations again in the backward pass.
        method: name of the method to run.

    Returns:
        The output of the method.
    """

    def call(block: nn.Module, x: jax.Array) -> jax.Array:
        return getattr(block, method)(x, train=train)

    return nn.remat(call)(block, x) if is_recomputed else call(block, x)
