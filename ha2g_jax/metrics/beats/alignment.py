"""Beat alignment, the corrected beat consistency: recall, precision and F of each clip, for all clips at once.

The paper (HA2G, section 4.3 and supplement E) asks only whether each onset has a motion beat near it, so that dense
random beats score best and a motionless clip can be left out. Here both directions count (recall R of the onsets,
precision Q of the motion beats, F = 2 R Q / (R + Q)), a motionless clip scores 0, and the number to report is the gain
of F over that with mismatched speech. A value is good if it is close to that of the real motion, not if it is high.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ha2g_jax.metrics.beats.times import kernel, nearest

# Attempts for each clip to draw; a motion whose attempts all fail is handled separately.
_TRIES = 4
_ROUNDING = 1e-9  # seconds


class Clip(NamedTuple):
    """Times (m,) of the motion beats and (k,) of the onsets of one clip in seconds. Only times between start and end,
    the bounds of the scored part, count, also as neighbours.
    """

    beats: np.ndarray
    onsets: np.ndarray
    start: float
    end: float


class Alignment(NamedTuple):
    """Scores of n clips, each field (n,). Recall, precision and F of silent clips are NaN.

    Attributes:
        recall: mean over onsets of the kernel to the nearest motion beat, R.
        precision: mean over motion beats of the kernel to the nearest onset, Q.
        f: 2 R Q / (R + Q).
        onset_sum: sum of the kernels that R is the mean of.
        num_onsets, num_beats: numbers of onsets and of motion beats.
        seconds: length of the scored part.
    """

    recall: np.ndarray
    precision: np.ndarray
    f: np.ndarray
    onset_sum: np.ndarray
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
    """Ascending times of n clips, concatenated: values (m,), the clip of each (m,), and their number per clip (n,)."""

    values: np.ndarray
    owners: np.ndarray
    counts: np.ndarray


def align(clips: Sequence[Clip]) -> Alignment:
    """Compute recall, precision and F of each clip with its own sound, with `times.kernel` (Eq. 11).

    A clip with onsets and no motion beats scores 0. A clip without onsets is silent and not scored.

    Raises:
        ValueError: a time is not a number.
    """
    return score(inside(clips, "beats"), inside(clips, "onsets"), durations(clips))


def score(moves: Times, sounds: Times, seconds: np.ndarray) -> Alignment:
    """Compute the alignment of n clips of (n,) seconds, from the times of all motion beats and all onsets."""
    onset_sum, beat_sum = _kernel_sums(sounds, moves), _kernel_sums(moves, sounds)
    has_sound = sounds.counts > 0
    recall = np.where(has_sound, onset_sum / np.maximum(sounds.counts, 1), np.nan)
    precision = np.where(has_sound, beat_sum / np.maximum(moves.counts, 1), np.nan)
    f = harmonic_mean(recall, precision)
    return Alignment(recall, precision, f, onset_sum, sounds.counts, moves.counts, seconds)


def inside(clips: Sequence[Clip], name: str) -> Times:
    """Return the beats or the onsets of clips between start and end, in seconds from the start."""
    parts = [getattr(clip, name) for clip in clips]
    owners = np.repeat(np.arange(len(clips)), np.array([len(part) for part in parts], int))
    values = np.concatenate([np.zeros(0), *parts])
    starts, ends = (np.array([getattr(clip, end) for clip in clips]) for end in ("start", "end"))
    if np.isnan(values).any():
        raise ValueError(f"{name} at times that are not numbers")
    is_inside = (values >= starts[owners]) & (values < ends[owners])
    values, owners = (values - starts[owners])[is_inside], owners[is_inside]
    if np.any((np.diff(values) < 0) & (np.diff(owners) == 0)):
        order = np.lexsort((values, owners))
        values, owners = values[order], owners[order]
    return Times(values, owners, np.bincount(owners, minlength=len(clips)))


def durations(clips: Sequence[Clip]) -> np.ndarray:
    """Return the seconds (n,) from start to end, 0 for motion that has only seed poses."""
    return np.array([max(clip.end - clip.start, 0.0) for clip in clips])


def harmonic_mean(first: np.ndarray | float, second: np.ndarray | float) -> np.ndarray:
    """Return 2 a b / (a + b), 0 where both are 0."""
    total = first + second
    return 2 * first * second / np.where(total == 0, 1, total)


def _kernel_sums(times: Times, others: Times) -> np.ndarray:
    distances = nearest(times.values, others.values, times.owners, others.owners)
    return np.bincount(times.owners, kernel(distances), minlength=len(times.counts))


def partners(
    clips: Sequence[Clip], recordings: Sequence[str | int] | np.ndarray, *, num: int = 5, seed: int = 0
) -> np.ndarray:
    """Draw `num` other clips for each clip from those with sound, of another recording (n,), that last as long.

    A clip is drawn at most once. If fewer than `num` last as long, the longest of the shorter ones are added. The draw
    does not depend on the motion, so methods that are compared on the same clips get the same partners. The result
    (n, num) has the indices of clips, -1 where other recordings have too few.
    """
    rng = np.random.default_rng(seed)
    _, codes = np.unique(np.asarray(recordings), return_inverse=True)
    seconds = durations(clips)
    pool = np.flatnonzero(inside(clips, "onsets").counts)
    pool = pool[np.argsort(-seconds[pool], kind="stable")]
    as_long = np.searchsorted(-seconds[pool], _ROUNDING - seconds, side="right")
    drawn = np.full((len(seconds), num), -1)
    if not num or not len(pool):
        return drawn
    tries = (rng.random((len(seconds), _TRIES * num)) * as_long[:, None]).astype(int)
    is_bad = (codes[pool[tries]] == codes[:, None]) | _is_repeated(tries) | (as_long == 0)[:, None]
    is_full = np.count_nonzero(~is_bad, axis=1) >= num
    first_good = np.argsort(is_bad[is_full], axis=1, kind="stable")[:, :num]
    drawn[is_full] = pool[np.take_along_axis(tries[is_full], first_good, axis=1)]
    for clip in np.flatnonzero(~is_full):
        others = np.flatnonzero(codes[pool] != codes[clip])
        candidates = others[: max(num, np.count_nonzero(others < as_long[clip]))]
        chosen = rng.choice(candidates, min(num, len(candidates)), replace=False)
        drawn[clip, : len(chosen)] = pool[chosen]
    return drawn


def mismatched(
    clips: Sequence[Clip],
    recordings: Sequence[str | int] | np.ndarray,
    num: int = 5,
    seed: int = 0,
) -> np.ndarray:
    """Compute the F of each clip (n,) with the sound of other clips, as the mean over `num` of them.

    The other clips are of another recording, have sound, and are cut to the length of the clip; if there are too few
    that are long enough, shorter ones are repeated. Those that are silent for that length are left out of the mean. The
    result is NaN without sound of another recording. The draw depends on the seed, and on the times and onsets of the
    clips, but not on the motion.
    """
    return with_partners(clips, partners(clips, recordings, num=num, seed=seed))


def with_partners(clips: Sequence[Clip], others: np.ndarray) -> np.ndarray:
    """Compute the mean F (n,) of each clip with the sound of the clips (n, num) that `partners` drew for it."""
    moves, sounds, seconds = inside(clips, "beats"), inside(clips, "onsets"), durations(clips)
    total, count = np.zeros(len(clips)), np.zeros(len(clips), int)
    for other in others.T:
        f = score(moves, _sounds_of(other, sounds, seconds), seconds).f
        is_scored = ~np.isnan(f)
        total[is_scored] += f[is_scored]
        count += is_scored
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _sounds_of(other: np.ndarray, sounds: Times, seconds: np.ndarray) -> Times:
    """Return the onsets of other clips (n,), cut or repeated to the seconds (n,) of each clip; none for other = -1."""
    clips = np.flatnonzero(other >= 0)
    lengths = np.maximum(seconds[other[clips]], _ROUNDING)
    copies = np.maximum(np.ceil(seconds[clips] / lengths - _ROUNDING), 1).astype(int)
    copy, pair = _count_up(copies)
    counts = sounds.counts[other[clips]]
    within, copied = _count_up(counts[pair])
    firsts = (np.cumsum(sounds.counts) - sounds.counts)[other[clips]]
    values = sounds.values[firsts[pair][copied] + within] + (copy * lengths[pair])[copied]
    owners = clips[pair][copied]
    is_inside = values < seconds[owners]
    return Times(values[is_inside], owners[is_inside], np.bincount(owners[is_inside], minlength=len(seconds)))


def _count_up(counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return 0 to count - 1 for each count, concatenated, and the index of the count that each belongs to."""
    owners = np.repeat(np.arange(len(counts)), counts)
    return np.arange(len(owners)) - np.repeat(np.cumsum(counts) - counts, counts), owners


def _is_repeated(rows: np.ndarray) -> np.ndarray:
    order = np.argsort(rows, axis=1, kind="stable")
    ordered = np.take_along_axis(rows, order, axis=1)
    is_same = np.zeros(rows.shape, bool)
    is_same[:, 1:] = ordered[:, 1:] == ordered[:, :-1]
    repeated = np.empty_like(is_same)
    np.put_along_axis(repeated, order, is_same, axis=1)
    return repeated
