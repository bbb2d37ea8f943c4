"""Kinematics, regardless of the speech: acceleration, jerk, spread, speeds, and angles beyond those of training.

Other evaluations report these (GENEA, Audio2Gestures). None is a score of quality: compare a value with that of the
real motion. All given joints count; units are those of the positions.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from ha2g_jax.metrics.metric import BEATS, LIKENESS, MOVEMENT, Metric, Statistic
from ha2g_jax.metrics.row import SEED_FRAMES, Reference, Row, mean_over_clips, ratio
from ha2g_jax.skeleton import joint_angles

NUM_BINS = 50
NUM_HALVES = 20  # random divisions of ground truth

STILL = 1e-5  # units per second below which a joint does not move: the rounding error of float32 positions

QUANTILES = (0.001, 0.999)

_BEYOND = 1 + 1e-4  # times the greatest speed: only above this is a speed beyond the last bin, not a rounding error

_ROUNDING = 1e-6  # radians by which an angle may lie outside, because the same pose may be rounded differently
_RIGID = np.deg2rad(0.5)  # range of an angle that does not bend in the training motion


def acceleration(positions: np.ndarray, fps: float) -> float:
    """Compute the mean length of the second difference of positions x fps^2 (GENEA); NaN for fewer than 3 frames.

    Raises:
        ValueError: the positions are not (T, joints, 3).
    """
    return _mean_difference(positions, 2, fps)


def jerk(positions: np.ndarray, fps: float) -> float:
    """Compute the mean length of the third difference x fps^3 (GENEA's average jerk), see `acceleration`."""
    return _mean_difference(positions, 3, fps)


def l1_diversity(values: np.ndarray) -> float:
    """Compute the spread of a sequence around its mean, (1/T) sum_t sum_d |x_td - mean_t x_d| (Audio2Gestures, 2021).

    It is in units of the values (T, ...), 0 for motion that stands still, and NaN without a frame.
    """
    if not len(values):
        return np.nan
    values = np.asarray(values, np.float64).reshape(len(values), -1)
    return float(np.mean(np.sum(np.abs(values - values.mean(axis=0)), axis=1)))


def _mean_difference(positions: np.ndarray, order: int, fps: float) -> float:
    lengths = _differences(positions, order, fps)
    return float(np.mean(lengths)) if len(lengths) else np.nan


def _differences(positions: np.ndarray, order: int, fps: float) -> np.ndarray:
    """Return the lengths (T - order, joints) of the differences of positions (T, joints, 3) x fps^order."""
    positions = np.asarray(positions, np.float64)
    if positions.ndim != 3 or positions.shape[2] != 3:
        raise ValueError(f"positions of the shape {positions.shape}; expected (T, joints, 3)")
    return np.linalg.norm(np.diff(positions, n=order, axis=0), axis=-1) * fps**order


def _by_frames(function: Callable[..., float]) -> Callable[[Row], Statistic]:
    def measure(row: Row) -> Statistic:
        values = [function(positions[SEED_FRAMES:], row.reference.fps) for positions in row.positions]
        return mean_over_clips(row, values, row.num_scored)

    return measure


def _over_truth(measure: Callable[[Row], Statistic]) -> Callable[[Row], Statistic]:
    """Return a measure: the value of a row divided by that of ground truth."""
    return lambda row: ratio(measure(row), row.reference.truth.once(measure))


def _spread(row: Row) -> Statistic:
    values = [l1_diversity(directions[SEED_FRAMES:]) for directions in row.directions]
    return mean_over_clips(row, values, row.num_scored)


_acceleration, _jerk = _by_frames(acceleration), _by_frames(jerk)

L1_DIVERSITY = Metric("l1_diversity", "L1 diversity", "", "higher", LIKENESS, 2, _spread, is_paired=True)
ACCELERATION = Metric("acceleration", "acc.", "m/s²", "none", MOVEMENT, 2, _acceleration, is_paired=True)
ACCELERATION_RATIO = Metric("acceleration_ratio", "acc. / truth", "", "none", MOVEMENT, 2, _over_truth(_acceleration))
JERK = Metric("jerk", "jerk", "m/s³", "none", MOVEMENT, 1, _jerk, is_paired=True)
JERK_RATIO = Metric("jerk_ratio", "jerk / truth", "", "none", BEATS, 2, _over_truth(_jerk))


def speed_edges(reference: Sequence[np.ndarray], fps: float, *, bins: int = NUM_BINS) -> np.ndarray:
    """Return upper edges (joints, bins) at the quantiles 1/bins, 2/bins, ..., 1 of the speeds of clips (T, joints, 3).

    The last one is larger than the greatest speed by a factor of 1 + 1e-4, so that the same motion in another format is
    not beyond it.

    Raises:
        ValueError: positions of another shape.
    """
    speeds = np.concatenate([_speeds(clip, fps) for clip in reference])
    if not len(speeds):
        return np.zeros((speeds.shape[1], bins))
    edges = np.quantile(speeds, np.arange(1, bins + 1) / bins, axis=0).T
    edges[:, -1] *= _BEYOND
    return edges


def speed_counts(positions: np.ndarray, edges: np.ndarray, fps: float) -> np.ndarray:
    """Count the speeds of each joint of one clip (T, joints, 3); the counts of clips add up.

    The edges, (bins,) or (joints, bins), are ascending upper edges, which belong to their bins, in units of the
    positions per second. The counts (joints, 1 + bins + 1) are those of standing still, of each bin, and of speeds
    beyond the last.

    Raises:
        ValueError: positions of another shape.
    """
    speeds = _speeds(positions, fps)
    num_joints, num_bins = speeds.shape[1], edges.shape[-1]
    counts = np.zeros((num_joints, num_bins + 2))
    for joint, joint_edges in enumerate(np.broadcast_to(edges, (num_joints, num_bins))):
        is_moving = speeds[:, joint] > 0
        places = np.where(is_moving, 1 + np.searchsorted(joint_edges, speeds[:, joint]), 0)
        counts[joint] = np.nan if np.isnan(speeds[:, joint]).any() else np.bincount(places, minlength=num_bins + 2)
    return counts


def histogram_distance(counts: np.ndarray, reference: np.ndarray) -> float:
    """Compute the mean over joints of the Hellinger distance sqrt(1 - sum_i sqrt(p_i q_i)) of speeds (GENEA).

    Both sides are sums (joints, 1 + bins + 1) of `speed_counts`. A joint that moves on neither side is left out. NaN
    where either side has no counts.

    Raises:
        ValueError: the two sides have different shapes.
    """
    if counts.shape != reference.shape:
        raise ValueError(f"counts of the shapes {counts.shape} and {reference.shape}; expected the same")
    # Standing still belongs to the first bin, that of the slowest; it is counted separately only to find dead joints.
    parts = []
    for side in (counts, reference):
        if not side.sum():
            return np.nan
        binned = np.concatenate([side[:, :1] + side[:, 1:2], side[:, 2:]], axis=1)
        parts.append(binned / binned.sum(axis=1, keepdims=True))
    moves = (counts[:, 1:].sum(axis=1) != 0) | (reference[:, 1:].sum(axis=1) != 0)
    overlap = np.sum(np.sqrt(parts[0] * parts[1]), axis=1)[moves]
    return float(np.mean(np.sqrt(np.maximum(1 - overlap, 0)))) if moves.any() else 0.0


def _speeds(positions: np.ndarray, fps: float) -> np.ndarray:
    """Return the speeds (frames - 1, joints); those below the rounding error of positions are 0."""
    speeds = _differences(positions, 1, fps)
    return np.where(speeds < STILL, 0, speeds)


def _truth_edges(reference: Reference) -> np.ndarray:
    return speed_edges([clip[SEED_FRAMES:] for clip in reference.truth.positions], reference.fps)


def _speeds_by_recording(row: Row) -> np.ndarray:
    reference = row.reference
    edges = reference.once(_truth_edges)
    counts = np.zeros((reference.num_recordings, reference.skeleton.num_joints, edges.shape[-1] + 2))
    for positions, member in zip(row.positions, row.members, strict=True):
        counts[member] += speed_counts(positions[SEED_FRAMES:], edges, reference.fps)
    return counts


def _distance_to_truth(row: Row) -> Statistic:
    own, true = row.once(_speeds_by_recording), row.reference.truth.once(_speeds_by_recording)
    return lambda drawn: histogram_distance(np.tensordot(drawn, own, axes=1), np.tensordot(drawn, true, axes=1))


def _halves(truth: Row) -> np.ndarray | None:
    counts, number = truth.once(_speeds_by_recording), truth.reference.num_recordings
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
    "speed_hellinger", "speed Hellinger", "", "lower", LIKENESS, 3, _distance_to_truth, halves=_halves, is_paired=True
)


class Limits(NamedTuple):
    """The 0.1 % and the 99.9 % quantile of each angle in the training motion, (pairs,) each, in radians."""

    low: np.ndarray
    high: np.ndarray


class Violations(NamedTuple):
    """Fractions of frames with an angle beyond its limits: the mean over angles, the worst angle, and any angle."""

    mean: float
    worst: float
    any: float


def training_limits(angles: np.ndarray) -> Limits:
    """Return the limits of angles (frames, pairs) in radians, all frames of the training motion together."""
    low, high = np.quantile(np.asarray(angles, np.float64), QUANTILES, axis=0)
    return Limits(low, high)


def violation_counts(angles: np.ndarray, limits: Limits) -> np.ndarray:
    """Count the violations of one clip, from which the fractions for any set of clips are computed.

    The angles (T, pairs) in radians are those of float64 directions. The counts (2 + pairs,) are numbers of frames, of
    frames with any angle outside, and of frames with each angle outside.
    """
    is_outside = (angles < limits.low - _ROUNDING) | (angles > limits.high + _ROUNDING)
    is_outside = np.where(np.isnan(angles), np.nan, is_outside)
    return np.array([len(angles), is_outside.max(axis=1).sum(), *is_outside.sum(axis=0)], np.float64)


def violations(counts: np.ndarray) -> Violations:
    """Return the violations of clips from the sum (2 + pairs,) of their `violation_counts`."""
    frames, any_outside, *outside = counts
    if not frames:
        return Violations(np.nan, np.nan, np.nan)
    each = np.array(outside) / frames
    return Violations(float(each.mean()), float(each.max()), float(any_outside / frames))


def _usual_limits(reference: Reference) -> Limits:
    """Return the limits of the training motion; rigid angles have none, because any change would violate them."""
    clips = [joint_angles(reference.skeleton, np.asarray(clip, np.float64)) for clip in reference.training]
    low, high = training_limits(np.concatenate(clips))
    is_rigid = high - low < _RIGID
    return Limits(np.where(is_rigid, -np.inf, low), np.where(is_rigid, np.inf, high))


def _violations_by_recording(row: Row) -> np.ndarray:
    reference = row.reference
    limits = reference.once(_usual_limits)
    counts = np.zeros((reference.num_recordings, 2 + len(reference.skeleton.angle_pairs)))
    for directions, member in zip(row.directions, row.members, strict=True):
        scored = np.asarray(directions[SEED_FRAMES:], np.float64)
        counts[member] += violation_counts(joint_angles(reference.skeleton, scored), limits)
    return counts


def _limits(name: str) -> Callable[[Row], Statistic]:
    def measure(row: Row) -> Statistic:
        counts = row.once(_violations_by_recording)
        return lambda drawn: getattr(violations(drawn @ counts), name)

    return measure


LIMITS_MEAN = Metric("limits_mean", "beyond limits", "", "lower", MOVEMENT, 3, _limits("mean"))
LIMITS_WORST = Metric("limits_worst", "worst angle", "", "lower", MOVEMENT, 3, _limits("worst"))
LIMITS_ANY = Metric("limits_any", "any angle", "", "lower", MOVEMENT, 3, _limits("any"))
