"""Split a batch into chunks whose arrays fit the caches of a processor."""

import math

import jax


def split(x: jax.Array, images: int) -> jax.Array:
    """Split a batch into chunks, for a loop over the second axis.

    A chunk has the images at the same place of each part of the batch, and at least one image of each device, so that
    a batch that is split over devices stays split.

    Args:
        x: (B, ...).
        images: number of images of a chunk, at least; the next power of two or, where that does not divide B, less.

    Returns:
        (images of a chunk, number of chunks, ...).
    """
    chunk = math.gcd(len(x), 1 << (max(images, jax.device_count()) - 1).bit_length())
    return x.reshape(chunk, len(x) // chunk, *x.shape[1:])


def take(parts: jax.Array, index: jax.Array) -> jax.Array:
    """Return the chunk (images of a chunk, ...) at an index of the result of `split`."""
    return jax.lax.dynamic_index_in_dim(parts, index, axis=1, keepdims=False)
