"""Motion beats as stops of the body: the minima of the angle change rate (HA2G, section 4.3)."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ha2g_jax.metrics.beats.times import minima

THRESHOLD = 0.03  # rise of the angle change rate on both sides of a motion beat
FIRST_FRAME = 4  # frames before it are the seed poses


class Clip(NamedTuple):
    """Motion beats and onsets of one clip.

    Attributes:
        beats: (m,) times of the motion beats in seconds.
        onsets: (k,) times of the onsets of the sound in seconds.
        start, end: bounds in seconds of what is scored; a time outside of them is no neighbour either.
    """

    beats: np.ndarray
    onsets: np.ndarray
    start: float
    end: float


def stop_beats(
    rate: np.ndarray, fps: float, first_frame: int = FIRST_FRAME, threshold: float = THRESHOLD
) -> np.ndarray:
    """Return the times in seconds, (n,), at which a motion stops: the local minima of its angle change rate.

    The rate rises on both sides, to the nearest local maximum there, by at least the threshold. A parabola through the
    minimum and its neighbours places it between frames. Minima are strict, but for two equal samples, as a stop right
    on a frame makes them. A pose held without any change for longer is no motion beat.

    Args:
        rate: (T - 1,) angle change rate of the whole motion.
        fps: frames per second.
        first_frame: first frame that is looked at.
        threshold: least rise; the rate has no unit and is about 1 on average.
    """
    times, _, rise = find_stops([rate], fps, first_frame)
    return times[rise >= threshold]


def make_clips(
    rates: Sequence[np.ndarray] | np.ndarray,
    onsets: Sequence[np.ndarray],
    fps: float | np.ndarray,
    *,
    first_frame: int = FIRST_FRAME,
    threshold: float = THRESHOLD,
) -> list[Clip]:
    """Find the motion beats of all clips at once, in the frames from first_frame to T - 1.

    Args:
        rates: (T - 1,) rate of each clip, from `angle_change_rates`.
        onsets: (k,) onsets of each clip in seconds from frame 0.
        fps: frames per second, of all clips or (n,).
        first_frame, threshold: as for `stop_beats`.
    """
    times, owners, rise = find_stops(rates, fps, first_frame)
    is_beat = rise >= threshold
    parts = np.split(times[is_beat], np.searchsorted(owners[is_beat], np.arange(1, len(rates))))[: len(rates)]
    rows = zip(parts, onsets, rates, np.broadcast_to(fps, len(rates)).tolist(), strict=True)
    return [Clip(beat, onset, first_frame / rate, (len(curve) + 1) / rate) for beat, onset, curve, rate in rows]


def find_stops(
    rates: Sequence[np.ndarray] | np.ndarray, fps: float | np.ndarray, first_frame: int = FIRST_FRAME
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return time in seconds, clip and rise, (m,) each, of all minima of the rates (T - 1,) of n clips."""
    scored = [rate[first_frame:] for rate in rates]
    lengths = np.array([len(rate) for rate in scored], int)
    starts = np.cumsum(lengths) - lengths
    is_first = np.zeros(lengths.sum(), bool)
    is_first[starts[lengths > 0]] = True
    found = minima(np.concatenate([np.zeros(0), *scored]), is_first=is_first, equal=True)
    owners = np.repeat(np.arange(len(lengths)), lengths)[found.sample]
    frames = first_frame + found.sample - starts[owners] + found.offset + 0.5
    return frames / np.broadcast_to(fps, len(lengths))[owners], owners, found.rise
