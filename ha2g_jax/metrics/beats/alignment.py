"""Beat alignment, the corrected beat consistency: recall, precision and F of each clip, for all clips at once.

The paper (HA2G, section 4.3 and supplement E) asks only whether each onset has a motion beat near it, so that dense
random beats score best and a motionless clip can be left out. Here both directions count (recall R of the onsets,
precision Q of the motion beats, F = 2 R Q / (R + Q)), a motionless clip scores 0, and the number to report is the gain
of F over that with mismatched speech. Closer to the real motion's values is better, not higher.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ha2g_jax.metrics.beats.stops import Clip
from ha2g_jax.metrics.beats.times import SIGMA, kernel, nearest


class Alignment(NamedTuple):
    """Scores of n clips, each field (n,). Recall, precision and F of silent clips are NaN.

    Attributes:
        recall: mean over onsets of the kernel to the nearest motion beat, R.
        precision: mean over motion beats of the kernel to the nearest onset, Q.
        f: 2 R Q / (R + Q).
        onset_sum, beat_sum: sums of kernels that R and Q are the means of.
        num_onsets, num_beats: numbers of onsets and of motion beats.
        seconds: length of what is scored.
    """

    recall: np.ndarray
    precision: np.ndarray
    f: np.ndarray
    onset_sum: np.ndarray
    beat_sum: np.ndarray
    num_onsets: np.ndarray
    num_beats: np.ndarray
    seconds: np.ndarray

    @property
    def is_silent(self) -> np.ndarray:
        """(n,) whether a clip has no onsets, so that it is not scored."""
        return self.num_onsets == 0

    def take(self, indices: np.ndarray) -> "Alignment":
        """Return the alignment of the clips at some indices."""
        return Alignment(*(values[indices] for values in self))


class Times(NamedTuple):
    """Ascending times of n clips end to end: values (m,), the clip of each (m,), and the number of each clip (n,)."""

    values: np.ndarray
    owners: np.ndarray
    counts: np.ndarray


def align(clips: Sequence[Clip], *, sigma: float = SIGMA) -> Alignment:
    """Compute recall, precision and F of each clip with its own sound.

    A clip with onsets and no motion beats scores 0. A clip without onsets is silent and not scored.

    Args:
        clips: n clips.
        sigma: width in seconds of the kernel exp(-d^2 / (2 sigma^2)) (Eq. 11).
    """
    seconds = durations(clips)
    return score(inside(clips, "beats"), inside(clips, "onsets"), seconds, sigma)


def score(moves: Times, sounds: Times, seconds: np.ndarray, sigma: float) -> Alignment:
    """Compute the alignment of n clips of (n,) seconds, from the times of all motion beats and all onsets."""
    onset_sum, beat_sum = _kernel_sums(sounds, moves, sigma), _kernel_sums(moves, sounds, sigma)
    has_sound = sounds.counts > 0
    recall = np.where(has_sound, onset_sum / np.maximum(sounds.counts, 1), np.nan)
    precision = np.where(has_sound, beat_sum / np.maximum(moves.counts, 1), np.nan)
    f = harmonic_mean(recall, precision)
    return Alignment(recall, precision, f, onset_sum, beat_sum, sounds.counts, moves.counts, seconds)


def inside(clips: Sequence[Clip], name: str) -> Times:
    """Return the beats or the onsets of clips between start and end, in seconds from the start."""
    parts = [getattr(clip, name) for clip in clips]
    owners = np.repeat(np.arange(len(clips)), np.array([len(part) for part in parts], int))
    values = np.concatenate([np.zeros(0), *parts])
    starts, ends = (np.array([getattr(clip, end) for clip in clips]) for end in ("start", "end"))
    is_inside = (values >= starts[owners]) & (values < ends[owners])
    values, owners = (values - starts[owners])[is_inside], owners[is_inside]
    if np.any((np.diff(values) < 0) & (np.diff(owners) == 0)):
        order = np.lexsort((values, owners))
        values, owners = values[order], owners[order]
    return Times(values, owners, np.bincount(owners, minlength=len(clips)))


def durations(clips: Sequence[Clip]) -> np.ndarray:
    """Return the seconds (n,) from start to end, 0 for motion of the seed poses only."""
    return np.array([max(clip.end - clip.start, 0.0) for clip in clips])


def harmonic_mean(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return 2 a b / (a + b), 0 where both are 0."""
    total = first + second
    return 2 * first * second / np.where(total == 0, 1, total)


def _kernel_sums(times: Times, others: Times, sigma: float) -> np.ndarray:
    distances = nearest(times.values, others.values, times.owners, others.owners)
    return np.bincount(times.owners, kernel(distances, sigma), minlength=len(times.counts))
