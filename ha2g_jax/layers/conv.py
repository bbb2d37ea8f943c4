"""Two-dimensional convolutions whose kernel gradient is a matrix product on CPUs.

XLA computes the gradient of a kernel with few channels on one core of a CPU. At the size of the paper this takes about
a third of a training step (docs/performance.md). Accelerators keep XLA's own gradient.
"""

import functools
import math

import jax
import jax.numpy as jnp
from flax import linen as nn

from ha2g_jax.layers import initializers

_LAYOUT = ("NHWC", "HWIO", "NHWC")
_CHUNK = 8  # images in one product: few enough for the caches; a batch that is split over devices stays split
_MIN_POSITIONS = 1 << 14  # of the output in all images; below this XLA's gradient is fast and compiles sooner


class Conv(nn.Module):
    """Convolution of images (B, H, W, C), channels last, with the parameters "kernel" and "bias" of `flax.linen.Conv`.

    Attributes:
        channels: number of output channels.
        kernel: height and width of the kernel.
        stride: stride along height and width.
        padding: number of zeros before and after each row and column.
        use_bias: whether to add a bias for each channel.
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
            y = y + self.param("bias", nn.initializers.zeros, (self.channels,))[None, None, None]
        return y


def conv(x: jax.Array, kernel: jax.Array, stride: tuple[int, int], padding: int) -> jax.Array:
    """Convolve images with a kernel.

    It is `jax.lax.conv_general_dilated` with another program for the gradient of the kernel, so that it has gradients
    of any order in reverse mode, but none in forward mode.

    Args:
        x: (B, H, W, inputs).
        kernel: (height, width, inputs, channels), of the type of `x`.
        stride: stride along height and width.
        padding: number of zeros before and after each row and column.

    Returns:
        (B, (H + 2 padding - height) // stride + 1, ..., channels).
    """
    return _conv_with_products(x, kernel, stride, padding)


def _conv(x: jax.Array, kernel: jax.Array, stride: tuple[int, int], padding: int) -> jax.Array:
    pairs = ((padding, padding), (padding, padding))
    return jax.lax.conv_general_dilated(x, kernel, stride, pairs, dimension_numbers=_LAYOUT)


def _forward(x, kernel, stride, padding):
    return _conv(x, kernel, stride, padding), (x, kernel)


def _backward(stride, padding, residuals, cotangent):
    x, kernel = residuals
    (x_gradient,) = jax.linear_transpose(lambda x: _conv(x, kernel, stride, padding), x)(cotangent)
    native = functools.partial(_kernel_gradient, kernel=kernel, stride=stride, padding=padding)
    if math.prod(cotangent.shape[:-1]) < _MIN_POSITIONS:
        return x_gradient, native(x, cotangent)
    products = functools.partial(kernel_gradient, size=kernel.shape[:2], stride=stride, padding=padding)
    return x_gradient, jax.lax.platform_dependent(x, cotangent, cpu=products, default=native)


_conv_with_products = jax.custom_vjp(_conv, nondiff_argnums=(2, 3))
_conv_with_products.defvjp(_forward, _backward)


def _kernel_gradient(
    x: jax.Array, cotangent: jax.Array, *, kernel: jax.Array, stride: tuple[int, int], padding: int
) -> jax.Array:
    return jax.linear_transpose(lambda kernel: _conv(x, kernel, stride, padding), kernel)(cotangent)[0]


def kernel_gradient(
    x: jax.Array, cotangent: jax.Array, *, size: tuple[int, int], stride: tuple[int, int], padding: int
) -> jax.Array:
    """Return the gradient of a kernel as matrix products, one for each row of the kernel and chunk of images.

    The columns that a row of the kernel covers are concatenated on the channels, so that each product is that of
    (width inputs, positions) and (positions, channels). Sums are float32.

    Args:
        x: (B, H, W, inputs) input of the convolution.
        cotangent: (B, H', W', channels) gradient of its output.
        size: height and width of the kernel.
        stride, padding: those of the convolution.

    Returns:
        (height, width, inputs, channels), of the type of `cotangent`.
    """
    (batch, *_, inputs), (_, height, width, channels) = x.shape, cotangent.shape
    rows, columns = size
    chunk = math.gcd(batch, _CHUNK)
    padded = jnp.pad(x, ((0, 0), (padding, padding), (padding, padding), (0, 0)))
    # The images of a chunk are those at the same place of each part of the batch.
    parts = padded.reshape(chunk, batch // chunk, *padded.shape[1:])
    cotangents = cotangent.reshape(chunk, batch // chunk, *cotangent.shape[1:])

    def add(total: jax.Array, index: jax.Array) -> tuple[jax.Array, None]:
        image = jax.lax.dynamic_index_in_dim(parts, index, axis=1, keepdims=False)
        out = jax.lax.dynamic_index_in_dim(cotangents, index, axis=1, keepdims=False).reshape(-1, channels)
        covered = jnp.concatenate([_every(image, 2, first, width, stride[1]) for first in range(columns)], axis=-1)
        products = [
            jax.lax.dot_general(
                out,
                _every(covered, 1, first, height, stride[0]).reshape(-1, columns * inputs),
                (((0,), (0,)), ((), ())),
                preferred_element_type=jnp.float32,
            )
            for first in range(rows)
        ]
        return total + jnp.stack(products), None

    start = jnp.zeros((rows, channels, columns * inputs), jnp.float32)
    total, _ = jax.lax.scan(add, start, jnp.arange(batch // chunk))
    return total.reshape(rows, channels, columns, inputs).transpose(0, 2, 3, 1).astype(cotangent.dtype)


def _every(x: jax.Array, axis: int, first: int, count: int, stride: int) -> jax.Array:
    return jax.lax.slice_in_dim(x, first, first + (count - 1) * stride + 1, stride, axis)
