"""Convolutions and batch normalisation of images, and the recomputation of both in the backward pass."""

import jax
import jax.numpy as jnp
from flax import linen as nn

from ha2g_jax.layers import initializers
from ha2g_jax.layers.cpu.convolution import conv

EPSILON = 1e-5
_MOMENTUM = 0.1


class Conv(nn.Module):
    """Convolution of images (B, H, W, C), channels last, with the parameters "kernel" and "bias" of `flax.linen.Conv`.

    Kernel and stride are along height and width; `padding` zeros are before and after each row and column.
    """

    channels: int
    kernel: tuple[int, int]
    stride: tuple[int, int] = (1, 1)
    padding: int = 0
    use_bias: bool = True

    @nn.compact
    def __call__(self, x: jax.Array) -> jax.Array:
        """Map (B, H, W, C) to (B, (H + 2 padding - kernel) // stride + 1, ..., channels)."""
        kernel = self.param("kernel", initializers.RESNET, (*self.kernel, x.shape[-1], self.channels))
        y = conv(x, kernel, self.stride, self.padding)
        if self.use_bias:
            y = y + self.param("bias", nn.initializers.zeros, (self.channels,), jnp.float32)[None, None, None]
        return y


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
        scale = self.param("scale", nn.initializers.ones, (channels,), jnp.float32)
        bias = self.param("bias", nn.initializers.zeros, (channels,), jnp.float32)
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


def run_block(
    block: nn.Module, x: jax.Array, *, train: bool, is_recomputed: bool, method: str = "__call__"
) -> jax.Array:
    """Run a module; if `is_recomputed`, keep only its input for the gradient and compute the activations again.

    This is meant for modules with BatchNorm over the whole batch, which cannot take the batch in parts. On CPUs it
    saves no memory, because XLA merges the second computation with the first.
    """

    def call(block: nn.Module, x: jax.Array) -> jax.Array:
        return getattr(block, method)(x, train=train)

    return nn.remat(call)(block, x) if is_recomputed else call(block, x)
