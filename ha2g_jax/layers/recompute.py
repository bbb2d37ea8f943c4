"""Less memory for more arithmetic in training."""

import jax
from flax import linen as nn


def run(block: nn.Module, x: jax.Array, *, train: bool, is_recomputed: bool, method: str = "__call__") -> jax.Array:
    """`block(x, train=train)`; where `is_recomputed`, its gradient keeps x alone and computes the rest again.

    For blocks with BatchNorm over the whole batch, which cannot take the batch in parts. On CPUs it saves nothing:
    there XLA merges the second computation with the first.

    Args:
        block: a module.
        x: what its method takes.
        train: as in the method.
        is_recomputed: of the model.
        method: name of the method to run.
    """

    def call(block: nn.Module, x: jax.Array) -> jax.Array:
        return getattr(block, method)(x, train=train)

    return nn.remat(call)(block, x) if is_recomputed else call(block, x)
