"""Resampling of features on a regular time grid to the frames of a window."""

import jax
import jax.numpy as jnp
import numpy as np


def frame_centres(num_frames: int, fps: float, margin: float = 0.0) -> np.ndarray:
    """Return the times (num_frames,) of the middles of frames, (n + 0.5) / fps seconds from the start of a window.

    With a margin, they start that many frames earlier; it may be fractional.
    """
    return (np.arange(num_frames) - margin + 0.5) / fps


def interpolate(x: jax.Array, places: np.ndarray, axis: int) -> jax.Array:
    """Interpolate values linearly at places (n,) on an axis; beyond the ends, return the end values.

    Places are in steps from the first value of the axis.
    """
    places = np.clip(places, 0, x.shape[axis] - 1)
    before = np.minimum(np.floor(places).astype(int), max(x.shape[axis] - 2, 0))
    after = np.minimum(before + 1, x.shape[axis] - 1)
    shape = [1] * x.ndim
    shape[axis] = len(places)
    weight = jnp.asarray(places - before, x.dtype).reshape(shape)
    return jnp.take(x, before, axis) * (1 - weight) + jnp.take(x, after, axis) * weight
