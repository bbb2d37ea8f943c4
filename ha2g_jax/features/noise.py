"""Noise that a generator reads together with the speech: a function of the seed and of the number of the frame.

Overlapping windows, a stream that samples a moment again two frames later, and another runtime all get the same noise
at the same moment. Half of the channels change within seconds, as stances do, the others within a stroke.
"""

from typing import Any

import numpy as np

PERIODS = (2.0, 0.5)  # seconds between independent values, of the first and of the second half of the channels


def track(seed: Any, frames: Any, fps: float, dim: int) -> Any:
    """Return noise (..., N, dim) float32, normal with mean 0 and variance 1 at each moment.

    Independent normal values lie at the points of a lattice in time, which is shifted differently for each channel;
    between two of them, a and b, the noise is

        a cos(w) + b sin(w),   w = pi/2 (3 u^2 - 2 u^3),   u from 0 to 1

    Args:
        seed: integers (...) below 2^32.
        frames: array (..., N), of numpy or jax, of the numbers of the frames, counted from 0 at the start of a clip;
            they may be negative.
        fps: frames per second.
        dim: number of channels.
    """
    frames, xp = frames[..., None], frames.__array_namespace__()
    channels = xp.arange(dim).reshape((1,) * (frames.ndim - 1) + (dim,))
    periods = xp.where(channels < dim // 2, *PERIODS)
    places = frames / (fps * periods) + channels / max(dim, 1)
    before = xp.floor(places)
    moment = places - before
    angle = np.pi / 2 * moment**2 * (3 - 2 * moment)
    seed = xp.asarray(seed, dtype=np.uint32)[..., None, None]
    points, channels = before.astype(np.int32).astype(np.uint32), channels.astype(np.uint32)
    values = [normal(seed, points + np.uint32(step), channels) for step in (0, 1)]
    return (values[0] * xp.cos(angle) + values[1] * xp.sin(angle)).astype(np.float32)


def normal(seed: Any, points: Any, channels: Any) -> Any:
    """Return the normal values of points of the lattice, from two hashes of each (Box and Muller 1958).

    Seed, points and channels are uint32 arrays whose shapes broadcast.
    """
    xp, mixed = channels.__array_namespace__(), _mix(_mix(seed) + points)
    first, second = ((_mix(mixed + np.uint32(2) * channels + np.uint32(half)) + 0.5) / 2.0**32 for half in (0, 1))
    return xp.sqrt(-2 * xp.log(first)) * xp.cos(2 * np.pi * second)


def _mix(bits: Any) -> Any:
    """Mix the bits of uint32 numbers (the hash "lowbias32" of Wellons 2018)."""
    bits = (bits ^ (bits >> np.uint32(16))) * np.uint32(0x7FEB352D)
    bits = (bits ^ (bits >> np.uint32(15))) * np.uint32(0x846CA68B)
    return bits ^ (bits >> np.uint32(16))
