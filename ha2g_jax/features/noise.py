"""Noise that a generator reads together with the speech: a function of the seed and of the number of the frame.

Overlapping windows, a stream that samples a moment again two frames later, and another runtime all get the same noise
at the same moment. Half of the channels change within seconds, as stances do, the others within a stroke.
"""

from typing import Any

import numpy as np

PERIODS = (2.0, 0.5)  # seconds between independent values, of the first and of the second half of the channels


def track(seed: Any, frames: Any, fps: float, dim: int, *, numpy: Any = np) -> Any:
    """Return noise (..., N, dim) float32, normal with mean 0 and variance 1 at each moment.

    Independent normal values lie at the points of a lattice in time, which is shifted differently for each channel;
    between two of them, a and b, the noise is

        a cos(w) + b sin(w),   w = pi/2 (3 u^2 - 2 u^3),   u from 0 to 1

    Args:
        seed: integers (...) below 2^32.
        frames: numbers (..., N) of the frames, counted from 0 at the start of a clip; they may be negative.
        fps: frames per second.
        dim: number of channels.
        numpy: numpy, or jax.numpy for the noise of training.
    """
    frames = numpy.asarray(frames)[..., None]
    channels = numpy.arange(dim).reshape((1,) * (frames.ndim - 1) + (dim,))
    periods = numpy.where(channels < dim // 2, *PERIODS)
    places = frames / (fps * periods) + channels / max(dim, 1)
    before = numpy.floor(places)
    moment = places - before
    angle = np.pi / 2 * moment**2 * (3 - 2 * moment)
    seed = numpy.asarray(seed, numpy.uint32)[..., None, None]
    points = before.astype(numpy.int32).astype(numpy.uint32)
    channels = channels.astype(numpy.uint32)
    values = [normal(seed, points + numpy.uint32(step), channels, numpy) for step in (0, 1)]
    return (values[0] * numpy.cos(angle) + values[1] * numpy.sin(angle)).astype(numpy.float32)


def normal(seed: Any, points: Any, channels: Any, numpy: Any = np) -> Any:
    """Return the normal values of points of the lattice, from two hashes of each (Box and Muller 1958).

    Seed, points and channels are uint32 arrays whose shapes broadcast.
    """
    mixed = _mix(_mix(seed, numpy) + points, numpy)
    first, second = (
        (_mix(mixed + numpy.uint32(2) * channels + numpy.uint32(half), numpy) + 0.5) / 2.0**32 for half in (0, 1)
    )
    return numpy.sqrt(-2 * numpy.log(first)) * numpy.cos(2 * np.pi * second)


def _mix(bits: Any, numpy: Any) -> Any:
    """Mix the bits of uint32 numbers (the hash "lowbias32" of Wellons 2018)."""
    bits = (bits ^ (bits >> numpy.uint32(16))) * numpy.uint32(0x7FEB352D)
    bits = (bits ^ (bits >> numpy.uint32(15))) * numpy.uint32(0x846CA68B)
    return bits ^ (bits >> numpy.uint32(16))
