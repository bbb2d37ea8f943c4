"""Hellinger distance of the distributions of joint speeds (GENEA), H = sqrt(1 - sum_i sqrt(p_i q_i)) in [0, 1]."""

from collections.abc import Sequence

import numpy as np

from ha2g_jax.metrics.metric import LIKENESS, Metric, Statistic
from ha2g_jax.metrics.row import SEED_FRAMES, Reference, Row

NUM_BINS = 50
NUM_HALVES = 20  # random divisions of ground truth

_STILL = 1e-5  # units a second below which a joint does not move: the rounding of float32 positions


def speed_edges(
    reference: Sequence[np.ndarray], fps: float, *, bins: int = NUM_BINS, first_frame: int = 4
) -> np.ndarray:
    """Return upper edges (joints, bins) at the quantiles 1/bins, 2/bins, ..., 1 of the reference's speeds."""
    speeds = np.concatenate([_speeds(clip, fps, first_frame) for clip in reference])
    if not len(speeds):
        return np.zeros((speeds.shape[1], bins))
    return np.quantile(speeds, np.arange(1, bins + 1) / bins, axis=0).T


def speed_counts(positions: np.ndarray, edges: np.ndarray, fps: float, *, first_frame: int = 4) -> np.ndarray:
    """Count the speeds of each joint in one clip; the counts of clips add up.

    Args:
        positions: (T, joints, 3) positions.
        edges: (bins,) or (joints, bins) ascending upper edges, each within its bin, in units of the positions a second.
        fps: frames per second.
        first_frame: first frame that is scored; those before it were given to the model.

    Returns:
        (joints, 1 + bins + 1) counts of standing still, of each bin, and of what lies beyond the last.
    """
    speeds = _speeds(positions, fps, first_frame)
    num_joints, num_bins = speeds.shape[1], edges.shape[-1]
    counts = np.zeros((num_joints, num_bins + 2))
    for joint, joint_edges in enumerate(np.broadcast_to(edges, (num_joints, num_bins))):
        is_moving = speeds[:, joint] > 0
        places = np.where(is_moving, 1 + np.searchsorted(joint_edges, speeds[:, joint]), 0)
        counts[joint] = np.bincount(places, minlength=num_bins + 2)
    return counts


def histogram_distance(counts: np.ndarray, reference: np.ndarray) -> float:
    """Compute the mean over joints of the Hellinger distance of two sums of `speed_counts`.

    Args:
        counts, reference: (joints, 1 + bins + 1) counts.

    Returns:
        The distance; a joint that moves nowhere is left out, so that two motions that stand still have 0. NaN where
        either side has no counts.
    """
    # Standing still belongs to the first bin, which holds the slowest; it is counted apart only to find dead joints.
    parts = []
    for side in (counts, reference):
        if not side.sum():
            return np.nan
        binned = np.concatenate([side[:, :1] + side[:, 1:2], side[:, 2:]], axis=1)
        parts.append(binned / binned.sum(axis=1, keepdims=True))
    moves = (counts[:, 1:].sum(axis=1) > 0) | (reference[:, 1:].sum(axis=1) > 0)
    overlap = np.sum(np.sqrt(parts[0] * parts[1]), axis=1)[moves]
    return float(np.mean(np.sqrt(np.maximum(1 - overlap, 0)))) if moves.any() else 0.0


def _speeds(positions: np.ndarray, fps: float, first_frame: int) -> np.ndarray:
    """Return the speeds (frames - 1, joints) of the scored frames; 0 below the rounding of positions."""
    scored = np.asarray(positions, np.float64)[first_frame:]
    speeds = np.linalg.norm(np.diff(scored, axis=0), axis=-1) * fps
    return np.where(speeds < _STILL, 0, speeds)


def _truth_edges(reference: Reference) -> np.ndarray:
    return speed_edges(reference.truth.positions, reference.fps, first_frame=SEED_FRAMES)


def _counts_by_recording(row: Row) -> np.ndarray:
    """Return the histograms (recordings, joints, bins) of the speeds of a row."""
    reference = row.reference
    edges = reference.once(_truth_edges)
    counts = np.zeros((reference.num_recordings, reference.skeleton.num_joints, edges.shape[-1] + 2))
    for positions, member in zip(row.positions, row.members, strict=True):
        counts[member] += speed_counts(positions, edges, reference.fps, first_frame=SEED_FRAMES)
    return counts


def _distance_to_truth(row: Row) -> Statistic:
    own, true = row.once(_counts_by_recording), row.reference.truth.once(_counts_by_recording)
    return lambda drawn: histogram_distance(np.tensordot(drawn, own, axes=1), np.tensordot(drawn, true, axes=1))


def _halves(truth: Row) -> np.ndarray | None:
    """Return the distances (n,) between random halves of the recordings."""
    counts, number = truth.once(_counts_by_recording), truth.reference.num_recordings
    if number < 2:
        return None
    rng = np.random.default_rng(truth.reference.seed)
    distances = []
    for _ in range(NUM_HALVES):
        is_first = np.zeros(number)
        is_first[rng.permutation(number)[: number // 2]] = 1
        distances.append(histogram_distance(*(np.tensordot(side, counts, axes=1) for side in (is_first, 1 - is_first))))
    return np.array(distances)


SPEED_HELLINGER = Metric(
    "speed_hellinger",
    "speed Hellinger",
    "",
    "lower",
    LIKENESS,
    3,
    _distance_to_truth,
    halves=_halves,
    is_paired=True,
)
