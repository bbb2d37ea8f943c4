"""Motion beats as stops of the body: minima of the angle change rate (HA2G, section 4.3), and beat consistency.

The angle change rate (Eq. 10 and 13) is the speed of the joint angles, each in units of its usual change: 1 for motion
as lively as the training set, whatever the skeleton and the frame rate. The rate between frames t and t + 1 belongs to
the time (t + 1/2) / fps. Jitter scores highest in beat consistency (BC, Eq. 11, supplement E), so report the score of
`alignment` instead. Where the paper is silent: motion beats are minima and lie between the two frames of a change, the
onsets of all clips have equal weight, and a motionless clip counts as 0.
"""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from ha2g_jax.metrics.beats.alignment import Alignment, Clip, align
from ha2g_jax.metrics.beats.times import minima
from ha2g_jax.metrics.row import SEED_FRAMES
from ha2g_jax.skeleton import Skeleton

# An angle that changes by less than this per frame, over pi, is rigid: all of the change is rounding. The least in TED
# is 1e-3.
_MIN_CHANGE = 1e-5
_MIN_NORM = 1e-8
# Frames worked on at once, so that their data stay in the cache of a core and memory does not grow with the motion.
_BLOCK = 384

THRESHOLD = 0.03  # rise of the angle change rate on both sides of a motion beat


def mean_angle_change(skeleton: Skeleton, clips: Iterable[np.ndarray]) -> np.ndarray:
    """Compute the mean absolute angle change of each angle pair (MAAC, Eq. 10),

        sum_s sum_t |theta_j,s(t + 1) - theta_j,s(t)| / sum_s (T_s - 1)

    of clips (T, bones, 3) of any positive length that may differ in T. It is (pairs,) over pi and per frame, at the fps
    of the clips; 0 where no clip has two frames.
    """
    total, count = np.zeros(len(skeleton.angle_pairs)), 0
    for changes in _changes(skeleton, clips):
        total += changes.sum(axis=1)
        count += changes.shape[1]
    return total / max(count, 1)


def angle_change_rates(
    skeleton: Skeleton, clips: Sequence[np.ndarray] | np.ndarray, change: np.ndarray | None = None
) -> list[np.ndarray]:
    """Compute the angle change rate (Eq. 13), the mean over pairs of |theta_j(t + 1) - theta_j(t)| / MAAC(theta_j).

    Rigid pairs (MAAC below 1e-5) are left out of the mean.

    Args:
        clips: (T, bones, 3) direction vectors, of any positive length, that may differ in T.
        change: (pairs,) MAAC over pi, per frame at the fps of the motion; by default that of the skeleton, at 15 fps.

    Returns:
        (T - 1,) float64 of each clip, no unit.

    Raises:
        ValueError: a direction is not a number.
    """
    per_frame = np.asarray(skeleton.angle_change if change is None else change, np.float64)
    moves = per_frame >= _MIN_CHANGE
    weights = np.where(moves, 1 / np.where(moves, per_frame, 1), 0) / max(np.count_nonzero(moves), 1)
    values = np.concatenate([np.zeros(0), *(weights @ changes for changes in _changes(skeleton, clips))])
    if np.isnan(values).any():
        raise ValueError("motion with directions that are not numbers has no angle change rate")
    lengths = [max(len(clip) - 1, 0) for clip in clips]
    return np.split(values, np.cumsum(lengths)[:-1]) if lengths else []


def _changes(skeleton: Skeleton, clips: Iterable[np.ndarray]) -> Iterator[np.ndarray]:
    """Yield blocks (pairs, steps) of |theta(t + 1) - theta(t)| / pi, through all steps of all clips in order."""
    for frames, is_step in _blocks(clips):
        yield np.abs(np.diff(_angles(skeleton, frames), axis=1))[:, is_step]


def _blocks(clips: Iterable[np.ndarray]) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield frames (m, bones, 3) of clips end to end, and whether each of the m - 1 steps is within a clip."""
    parts: list[np.ndarray] = []
    size = 0
    for clip in clips:
        # Parts of a long clip share a frame, so that no step is lost.
        for start in range(0, max(len(clip) - 1, 0), _BLOCK):
            part = clip[start : start + _BLOCK + 1]
            parts.append(part)
            size += len(part)
            if size >= _BLOCK:
                yield _joined(parts)
                parts, size = [], 0
    if parts:
        yield _joined(parts)


def _joined(parts: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    frames = np.concatenate(parts) if len(parts) > 1 else parts[0]
    is_step = np.ones(len(frames) - 1, bool)
    is_step[np.cumsum([len(part) for part in parts[:-1]], dtype=int) - 1] = False
    return frames, is_step


def _angles(skeleton: Skeleton, frames: np.ndarray) -> np.ndarray:
    """Compute the angles (pairs, m) over pi of frames (m, bones, 3), exact even where bones are parallel."""
    vectors = np.ascontiguousarray(frames.transpose(1, 2, 0), np.float64)
    if skeleton.palms:
        first, second = (vectors[list(bones)] for bones in zip(*skeleton.palms, strict=True))
        vectors = np.concatenate([vectors, np.cross(first, second, axis=1)])
    lengths = np.sqrt(np.maximum(np.einsum("bcm,bcm->bm", vectors, vectors), _MIN_NORM**2))
    first, second = (list(bones) for bones in zip(*skeleton.angle_pairs, strict=True))
    dots = np.einsum("pcm,pcm->pm", vectors[first], vectors[second])
    return np.arccos(np.clip(dots / (lengths[first] * lengths[second]), -1, 1)) / np.pi


def make_clips(
    rates: Sequence[np.ndarray], onsets: Sequence[np.ndarray], fps: float, *, threshold: float = THRESHOLD
) -> list[Clip]:
    """Find the motion beats of all clips at once: the local minima of the angle change rate after the seed pose.

    The rate, which is about 1 on average, must rise on both sides, to the nearest local maximum there, by at least the
    threshold. A parabola through the minimum and its neighbours places it between frames. Minima are strict, except
    that two equal lowest samples, which a stop exactly on a frame gives, count too. A pose held for longer without any
    change is not a motion beat.

    The rates (T - 1,) are those of `angle_change_rates`, the onsets (k,) are in seconds from frame 0.
    """
    scored = [rate[SEED_FRAMES:] for rate in rates]
    lengths = np.array([len(rate) for rate in scored], int)
    starts = np.cumsum(lengths) - lengths
    is_first = np.zeros(lengths.sum(), bool)
    is_first[starts[lengths > 0]] = True
    found = minima(np.concatenate([np.zeros(0), *scored]), is_first=is_first, equal=True)
    owners = np.repeat(np.arange(len(lengths)), lengths)[found.sample]
    times = (SEED_FRAMES + found.sample - starts[owners] + found.offset + 0.5) / fps
    is_beat = found.rise >= threshold
    parts = np.split(times[is_beat], np.searchsorted(owners[is_beat], np.arange(1, len(rates))))[: len(rates)]
    rows = zip(parts, onsets, rates, strict=True)
    return [Clip(beat, onset, SEED_FRAMES / fps, (len(rate) + 1) / fps) for beat, onset, rate in rows]


def low_samples(rate: np.ndarray, threshold: float) -> np.ndarray:
    """Return the indices of samples of a rate (n,) below both neighbours, and below one by the threshold."""
    before, after = rate[:-2] - rate[1:-1], rate[2:] - rate[1:-1]
    is_low = (before > 0) & (after > 0) & ((before >= threshold) | (after >= threshold))
    return 1 + np.flatnonzero(is_low)


def consistency(
    rates: Sequence[np.ndarray], onsets: Sequence[np.ndarray], fps: float, *, threshold: float = THRESHOLD
) -> Alignment:
    """Align clips with the motion beats of the paper; BC is the sum of `onset_sum` over the sum of `num_onsets`.

    The threshold is the least rise of the rate to the next frame; the other arguments are those of `make_clips`.
    """
    clips = []
    for rate, sounds in zip(rates, onsets, strict=True):
        samples = SEED_FRAMES + low_samples(rate[SEED_FRAMES:], threshold)
        clips.append(Clip((samples + 0.5) / fps, sounds, SEED_FRAMES / fps, (len(rate) + 1) / fps))
    return align(clips)


def beat_consistency(alignment: Alignment) -> float:
    """Return BC, the mean of the kernel over the onsets of all clips; NaN without an onset."""
    count = int(alignment.num_onsets.sum())
    return float(alignment.onset_sum.sum() / count) if count else float("nan")
