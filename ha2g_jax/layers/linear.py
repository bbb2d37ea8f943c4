"""Linear layers whose kernels start as those of torch.nn.Linear, and whose biases start at 0; tables of vectors."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
from flax import linen as nn

from ha2g_jax.layers.initializers import LINEAR

Linear = functools.partial(nn.Dense, kernel_init=LINEAR)


class Embedding(nn.Embed):
    """Table of vectors. The gradient of a row, a sum of thousands of terms for padding, is summed in float32."""

    dtype: Any = jnp.float32

    def __call__(self, inputs: jax.Array) -> jax.Array:
        """Map indices (...) to rows (..., features) of the type of the table."""
        return super().__call__(inputs).astype(self.embedding.dtype)


def mean_and_log_variance(x: jax.Array, channels: int) -> tuple[jax.Array, jax.Array]:
    """Map (B, values) to mean and log-variance of a normal distribution, (B, channels) each, in a compact module."""
    return Linear(channels, name="mean")(x), Linear(channels, name="log_variance")(x)
