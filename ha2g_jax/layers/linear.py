"""Linear layers whose kernels start as those of torch.nn.Linear, and whose biases start at 0."""

import functools

import jax
from flax import linen as nn

from ha2g_jax.layers.initializers import LINEAR

Linear = functools.partial(nn.Dense, kernel_init=LINEAR)


def mean_and_log_variance(x: jax.Array, channels: int) -> tuple[jax.Array, jax.Array]:
    """Map (B, values) to mean and log-variance of a normal distribution, (B, channels) each, in a compact module."""
    return Linear(channels, name="mean")(x), Linear(channels, name="log_variance")(x)
