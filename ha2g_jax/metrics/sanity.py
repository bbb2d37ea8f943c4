"""Reference rows of a table, made from real motion: mean pose, frozen, white jitter, smoothed, mismatched speech.

A metric that ranks one of them best does not measure quality. Each is a pure function of clips of direction vectors.
"""

import math
from collections.abc import Sequence

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.metrics.row import SEED_FRAMES
from ha2g_jax.skeleton import normalize

SMOOTHING = 5  # frames

TRUTH, HALF, MEAN_POSE, FROZEN, MISMATCHED, JITTER, SMOOTHED = (
    "ground truth",
    "ground truth, other half",
    "mean pose",
    "frozen",
    "mismatched speech",
    "white jitter",
    "smoothed ground truth",
)
SANITY_ROWS = (TRUTH, HALF, MEAN_POSE, FROZEN, MISMATCHED, JITTER, SMOOTHED)


def rows(clips: Sequence[np.ndarray], mean_directions: np.ndarray, *, seed: int = 0) -> dict[str, list[np.ndarray]]:
    """Make the rows whose motion is derived from real clips of direction vectors (T, bones, 3).

    The mean directions (bones, 3) of the training motion need not be of unit length. Each row has a motion (T, bones,
    3) of unit vectors, float64, for each clip.
    """
    spread = difference_spread(clips)
    rng = np.random.default_rng(seed)
    return {
        MEAN_POSE: [mean_pose(clip, mean_directions) for clip in clips],
        FROZEN: [frozen(clip) for clip in clips],
        JITTER: [white_jitter(clip, mean_directions, spread, rng) for clip in clips],
        SMOOTHED: [smoothed(clip) for clip in clips],
    }


def mean_pose(directions: np.ndarray, mean_directions: np.ndarray) -> np.ndarray:
    """Return the mean pose (bones, 3), normalised, in every frame of (T, bones, 3)."""
    pose = normalize(np.asarray(mean_directions, np.float64))
    return np.repeat(pose[None], len(directions), axis=0)


def frozen(directions: np.ndarray) -> np.ndarray:
    """Return the seed pose of real motion (T, bones, 3), whose last frame is held to the end."""
    return normalize(np.asarray(directions, np.float64))[np.minimum(np.arange(len(directions)), SEED_FRAMES - 1)]


def difference_spread(clips: Sequence[np.ndarray]) -> np.ndarray:
    """Return the standard deviation (bones, 3) of the frame differences of clips (T, bones, 3) after the seed pose."""
    steps = np.concatenate([np.diff(np.asarray(clip, np.float64)[SEED_FRAMES:], axis=0) for clip in clips])
    return steps.std(axis=0) if len(steps) else np.zeros(steps.shape[1:])


def white_jitter(
    directions: np.ndarray, mean_directions: np.ndarray, spread: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Return the mean pose plus N(0, s^2), normalised, with the spread s (bones, 3) of `difference_spread`."""
    pose = mean_pose(directions, mean_directions)
    return normalize(pose + rng.standard_normal(pose.shape) * spread)


def smoothed(directions: np.ndarray) -> np.ndarray:
    """Return the normalised mean over 5 frames around each frame of (T, bones, 3); fewer at the ends."""
    vectors = normalize(np.asarray(directions, np.float64))
    half = SMOOTHING // 2
    sums = np.concatenate([np.zeros_like(vectors[:1]), np.cumsum(vectors, axis=0)])
    frames = np.arange(len(vectors))
    starts, ends = np.maximum(frames - half, 0), np.minimum(frames + half + 1, len(vectors))
    return normalize(sums[ends] - sums[starts])


def derangement(
    recordings: Sequence[str], rng: np.random.Generator, *, lengths: Sequence[int] | None = None
) -> np.ndarray:
    """Choose for each clip a clip of another recording, whose speech is then mismatched with the motion.

    Among clips of equal length each is used once if no recording has more than half of them. A clip for which no other
    recording has one of equal length gets that of the nearest length, drawn if there are several. By default all
    lengths are equal. The result (n,) has the index of the other clip.

    Raises:
        UserError: all clips are of one recording.
    """
    names = np.unique(np.asarray(recordings), return_inverse=True)[1]
    if names.max(initial=0) == 0:
        raise UserError(
            f"all {len(names)} clips are of one recording; mismatched speech needs two: give clips of two or more"
        )
    sizes = np.zeros(len(names)) if lengths is None else np.asarray(lengths, np.float64)
    others = np.empty(len(names), int)
    for size in np.unique(sizes):
        group = rng.permutation(np.flatnonzero(sizes == size))
        counts = np.bincount(names[group])
        if 2 * counts.max() <= len(group):
            # In the order of recordings, a shift by the length of the longest run leaves every run.
            order = group[np.argsort(rng.permutation(len(counts))[names[group]], kind="stable")]
            others[order] = np.roll(order, -counts.max())
        else:
            for clip in group:
                others[clip] = _nearest(clip, names, sizes, rng)
    return others


def mismatched_onsets(
    onsets: Sequence[np.ndarray | None],
    recordings: Sequence[str],
    num_frames: Sequence[int],
    fps: float,
    *,
    seed: int = 0,
) -> list[np.ndarray | None]:
    """Return the onsets (n,) of a clip of another recording for each clip, see `derangement`.

    Those of a shorter clip are repeated for the length of the motion. The result is None for a clip without sound, and
    for all if all sound is of one recording.

    Args:
        onsets: times in seconds by clip, None without sound; those after the end of the motion are left out.
        recordings: recording of each clip.
        num_frames: length of the motion of each clip.
        fps: frames per second.
    """
    heard = [(clip, times[times < num_frames[clip] / fps]) for clip, times in enumerate(onsets) if times is not None]
    names = [recordings[clip] for clip, _ in heard]
    found: list[np.ndarray | None] = [None] * len(onsets)
    if len(set(names)) < 2:
        return found
    lengths = [num_frames[clip] for clip, _ in heard]
    partners = derangement(names, np.random.default_rng(seed), lengths=lengths)
    for (clip, _), length, partner in zip(heard, lengths, partners.tolist(), strict=True):
        copies = range(math.ceil(length / lengths[partner]))
        found[clip] = np.concatenate([heard[partner][1] + copy * lengths[partner] / fps for copy in copies])
    return found


def _nearest(clip: int, names: np.ndarray, sizes: np.ndarray, rng: np.random.Generator) -> int:
    candidates = np.flatnonzero(names != names[clip])
    distances = np.abs(sizes[candidates] - sizes[clip])
    return int(rng.choice(candidates[distances == distances.min()]))
