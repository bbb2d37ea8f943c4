"""Convolution of images with 3 x 3 kernels by Winograd's minimal filtering, F(2 x 2, 3 x 3) of Lavin and Gray 2016.

A tile of 4 x 4 inputs and the kernel are transformed to 4 x 4 values each. Their products, transformed back, are 2 x 2
outputs: 16 multiplications instead of 36. Over all tiles and channels they are 16 matrix products. The transforms
consist of sums, differences and halves, so that the result is about as exact as that of a direct convolution.
"""

import math
from collections.abc import Sequence

import jax
import jax.numpy as jnp

# B^T, G and A^T of the paper: the transforms of inputs, kernel and outputs along one axis.
_INPUT = ((1, 0, -1, 0), (0, 1, 1, 0), (0, -1, 1, 0), (0, 1, 0, -1))
_KERNEL = ((1, 0, 0), (0.5, 0.5, 0.5), (0.5, -0.5, 0.5), (0, 0, 1))
_OUTPUT = ((1, 1, 1, 0), (0, 1, -1, -1))
# Approximate number of input values transformed at a time: enough to be fast, few enough for the caches.
_VALUES = 1 << 19


def conv(x: jax.Array, kernel: jax.Array, padding: int) -> jax.Array:
    """Convolve images (B, H, W, inputs) with a kernel (3, 3, inputs, channels) and a stride of 1.

    The result is (B, H + 2 padding - 2, W + 2 padding - 2, channels).
    """
    batch, height, width, channels = len(x), x.shape[1] + 2 * padding - 2, x.shape[2] + 2 * padding - 2, kernel.shape[3]
    transformed = _kernel_tile(kernel)
    parts = split(x, math.ceil(_VALUES / math.prod(x.shape[1:])))

    def write(out: jax.Array, index: jax.Array) -> tuple[jax.Array, None]:
        tiles = _input_tiles(take(parts, index), padding, height, width)
        images = _from_output_tiles([tile @ values for tile, values in zip(tiles, transformed, strict=True)])
        return jax.lax.dynamic_update_index_in_dim(out, images[:, :height, :width], index, axis=1), None

    out = jnp.zeros((*parts.shape[:2], height, width, channels), x.dtype)
    out, _ = jax.lax.scan(write, out, jnp.arange(parts.shape[1]))
    return out.reshape(batch, height, width, channels)


def kernel_gradient(x: jax.Array, cotangent: jax.Array, padding: int) -> jax.Array:
    """Return the gradient of the kernel of `conv` from its input and the gradient of its output."""
    inputs, (_, height, width, channels) = x.shape[3], cotangent.shape
    images = math.ceil(_VALUES / math.prod(x.shape[1:]))
    parts, cotangents = split(x, images), split(cotangent, images)

    def add(total: jax.Array, index: jax.Array) -> tuple[jax.Array, None]:
        tiles = _input_tiles(take(parts, index), padding, height, width)
        gradients = _cotangent_tiles(take(cotangents, index))
        products = [
            gradient.reshape(-1, channels).T @ tile.reshape(-1, inputs)
            for tile, gradient in zip(tiles, gradients, strict=True)
        ]
        return total + jnp.stack(products), None

    total, _ = jax.lax.scan(add, jnp.zeros((16, channels, inputs), x.dtype), jnp.arange(parts.shape[1]))
    kernel = jax.ShapeDtypeStruct((3, 3, inputs, channels), x.dtype)
    return jax.linear_transpose(_kernel_tile, kernel)(total.transpose(0, 2, 1))[0]


def _kernel_tile(kernel: jax.Array) -> jax.Array:
    """Transform a kernel (3, 3, inputs, channels) to (16, inputs, channels)."""
    transform = jnp.asarray(_KERNEL, kernel.dtype)
    return jnp.einsum("ia,jb,abkc->ijkc", transform, transform, kernel).reshape(16, *kernel.shape[2:])


def _input_tiles(images: jax.Array, padding: int, height: int, width: int) -> list[jax.Array]:
    """Transform images to the 16 values of each tile, each (B, rows of tiles, columns of tiles, inputs)."""
    down, across = math.ceil(height / 2), math.ceil(width / 2)
    after = (2 * down + 2 - padding - images.shape[1], 2 * across + 2 - padding - images.shape[2])
    padded = jnp.pad(images, ((0, 0), (padding, after[0]), (padding, after[1]), (0, 0)))
    rows = [jax.lax.slice_in_dim(padded, first, first + 2 * down - 1, 2, axis=1) for first in range(4)]
    return [
        value
        for row in _transform(_INPUT, rows)
        for value in _transform(
            _INPUT, [jax.lax.slice_in_dim(row, first, first + 2 * across - 1, 2, axis=2) for first in range(4)]
        )
    ]


def _from_output_tiles(values: Sequence[jax.Array]) -> jax.Array:
    """Transform the 16 values of each tile, each (B, rows, columns, channels), to (B, 2 rows, 2 columns, channels)."""
    batch, down, across, channels = values[0].shape
    columns = [_transform(_OUTPUT, values[column::4]) for column in range(4)]
    # Updates in place copy faster than a stack, which XLA computes value by value.
    out = jnp.zeros((batch, down, 2, across, 2, channels), values[0].dtype)
    for row in range(2):
        for column, value in enumerate(_transform(_OUTPUT, [column[row] for column in columns])):
            out = jax.lax.dynamic_update_slice(out, value[:, :, None, :, None], (0, 0, row, 0, column, 0))
    return out.reshape(batch, 2 * down, 2 * across, channels)


def _cotangent_tiles(cotangent: jax.Array) -> list[jax.Array]:
    """Transform the gradient of `_from_output_tiles` to the gradients of its 16 arguments."""
    batch, height, width, channels = cotangent.shape
    down, across = math.ceil(height / 2), math.ceil(width / 2)
    padded = jnp.pad(cotangent, ((0, 0), (0, 2 * down - height), (0, 2 * across - width), (0, 0)))
    tiles = padded.reshape(batch, down, 2, across, 2, channels)
    transposed = tuple(zip(*_OUTPUT, strict=True))
    return [
        value
        for row in _transform(transposed, [tiles[:, :, 0], tiles[:, :, 1]])
        for value in _transform(transposed, [row[:, :, :, 0], row[:, :, :, 1]])
    ]


def _transform(matrix: Sequence[Sequence[float]], values: Sequence[jax.Array]) -> list[jax.Array]:
    """Multiply a matrix by a vector of arrays, skipping products with zero."""
    return [  # pyrefly: ignore[bad-return]
        sum(factor * value for factor, value in zip(row, values, strict=True) if factor) for row in matrix
    ]


def split(x: jax.Array, images: int) -> jax.Array:
    """Split a batch into chunks, for a loop over the second axis.

    A chunk takes images from all parts of the batch, at least one from each device, so that a batch (B, ...) that is
    split over devices stays split. The result is (images in a chunk, number of chunks, ...). A chunk has `images`
    images, rounded up to a power of two, or fewer where that does not divide B.
    """
    chunk = math.gcd(len(x), 1 << (max(images, jax.device_count()) - 1).bit_length())
    return x.reshape(chunk, len(x) // chunk, *x.shape[1:])


def take(parts: jax.Array, index: jax.Array) -> jax.Array:
    """Return the chunk (images of a chunk, ...) at an index of the result of `split`."""
    return jax.lax.dynamic_index_in_dim(parts, index, axis=1, keepdims=False)
