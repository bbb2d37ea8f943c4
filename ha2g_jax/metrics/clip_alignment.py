"""How well the motion beats and the onsets of each clip meet, for all clips at once."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ha2g_jax.metrics import beats
from ha2g_jax.metrics.clip_beats import Clip


class Alignment(NamedTuple):
    """Scores of n clips, each field (n,). Recall, precision and F of silent clips are NaN.

    Attributes:
        recall: mean over onsets of the kernel to the nearest motion beat, R.
        precision: mean over motion beats of the kernel to the nearest onset, Q.
        f: 2 R Q / (R + Q).
        heard, meant: the sums that R and Q are the means of.
        num_onsets, num_beats: how many there are.
        seconds: that are scored.
    """

    recall: np.ndarray
    precision: np.ndarray
    f: np.ndarray
    heard: np.ndarray
    meant: np.ndarray
    num_onsets: np.ndarray
    num_beats: np.ndarray
    seconds: np.ndarray

    @property
    def is_silent(self) -> np.ndarray:
        """(n,) clips without onsets, which are not scored."""
        return self.num_onsets == 0

    def take(self, indices: np.ndarray) -> "Alignment":
        """The alignment of some clips, for a bootstrap."""
        return Alignment(*(values[indices] for values in self))


class Times(NamedTuple):
    """Ascending times of many clips end to end: values (m,), the clip of each (m,), how many each of n clips has."""

    values: np.ndarray
    owners: np.ndarray
    counts: np.ndarray


def align(clips: Sequence[Clip], *, sigma: float = beats.SIGMA) -> Alignment:
    """Recall, precision and F of each clip with its own sound.

    A clip with onsets and no motion beats scores 0. A clip without onsets is silent and not scored.

    Args:
        clips: n clips.
        sigma: seconds, width of the kernel exp(-d^2 / (2 sigma^2)) (Eq. 11).
    """
    seconds = durations(clips)
    return score(inside(clips, "beats"), inside(clips, "onsets"), seconds, sigma)


def score(moves: Times, sounds: Times, seconds: np.ndarray, sigma: float) -> Alignment:
    """The alignment of n clips of (n,) seconds, from the times of all motion beats and all onsets."""
    heard, meant = _kernel_sums(sounds, moves, sigma), _kernel_sums(moves, sounds, sigma)
    has_sound = sounds.counts > 0
    recall = np.where(has_sound, heard / np.maximum(sounds.counts, 1), np.nan)
    precision = np.where(has_sound, meant / np.maximum(moves.counts, 1), np.nan)
    f = harmonic_mean(recall, precision)
    return Alignment(recall, precision, f, heard, meant, sounds.counts, moves.counts, seconds)


def inside(clips: Sequence[Clip], name: str) -> Times:
    """The beats or the onsets of clips between start and end, in seconds from the start."""
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
    """Seconds (n,) from start to end, 0 for motion of the seed poses only."""
    return np.array([max(clip.end - clip.start, 0.0) for clip in clips])


def harmonic_mean(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """2 a b / (a + b), 0 where both are."""
    total = first + second
    return 2 * first * second / np.where(total == 0, 1, total)


def _kernel_sums(times: Times, others: Times, sigma: float) -> np.ndarray:
    distances = beats.nearest(times.values, others.values, times.owners, others.owners)
    return np.bincount(times.owners, beats.kernel(distances, sigma), minlength=len(times.counts))
