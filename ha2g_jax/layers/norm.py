"""Batch normalisation with the numbers of PyTorch, in training and in evaluation."""

import jax
import jax.numpy as jnp
from flax import linen as nn

EPSILON = 1e-5
_MOMENTUM = 0.1


class BatchNorm(nn.Module):
    """Normalise each channel (last axis) over all other axes, as `torch.nn.BatchNorm*d`.

    Training normalises by the biased variance of the batch, and moves the running statistics by a tenth towards the
    mean and the *unbiased* variance of the batch; the layer of Linen keeps the biased variance. Statistics are float32.
    Under `jit` with the batch split over devices they are those of the global batch.
    """

    @nn.compact
    def __call__(self, x: jax.Array, *, train: bool) -> jax.Array:
        """Map (..., channels) to the same shape; in training the collection "batch_stats" must be mutable."""
        channels = x.shape[-1]
        scale = self.param("scale", nn.initializers.ones, (channels,))
        bias = self.param("bias", nn.initializers.zeros, (channels,))
        running_mean = self.variable("batch_stats", "mean", jnp.zeros, (channels,), jnp.float32)
        running_variance = self.variable("batch_stats", "variance", jnp.ones, (channels,), jnp.float32)

        def expand(values):
            return jnp.expand_dims(values, tuple(range(x.ndim - 1)))

        values = x.astype(jnp.float32)
        if train:
            axes = tuple(range(x.ndim - 1))
            mean = jnp.mean(values, axis=axes)
            variance = jnp.mean(jnp.square(values - expand(mean)), axis=axes)
            if not self.is_initializing():
                count = x.size // channels
                unbiased = variance * (count / max(count - 1, 1))
                running_mean.value = (1 - _MOMENTUM) * running_mean.value + _MOMENTUM * mean
                running_variance.value = (1 - _MOMENTUM) * running_variance.value + _MOMENTUM * unbiased
        else:
            mean, variance = running_mean.value, running_variance.value
        factor = scale * jax.lax.rsqrt(variance + EPSILON)
        return ((values - expand(mean)) * expand(factor) + expand(bias)).astype(x.dtype)
