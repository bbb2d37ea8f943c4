"""Angles between bones outside the range of the training motion."""

from typing import NamedTuple

import numpy as np

from ha2g_jax.metrics.metric import MOVEMENT, Metric, Statistic
from ha2g_jax.metrics.row import SEED_FRAMES, Reference, Row
from ha2g_jax.skeleton import joint_angles

QUANTILES = (0.001, 0.999)

_ROUNDING = 1e-6  # radians by which an angle may lie outside: two ways of rounding the same pose
_RIGID = np.deg2rad(0.5)  # range of an angle that does not bend in the training motion


class Limits(NamedTuple):
    """The 0.1 % and the 99.9 % quantile of each angle in the training motion, (pairs,) each, in radians."""

    low: np.ndarray
    high: np.ndarray


class Violations(NamedTuple):
    """Ratios of frames, in [0, 1]; NaN where no frame is scored.

    Attributes:
        mean: ratio of frames with an angle outside of its limits, mean over angles.
        worst: the same ratio of the angle that is outside most often.
        worst_pair: index of that angle.
        any: ratio of frames with any angle outside.
    """

    mean: float
    worst: float
    worst_pair: int
    any: float


def training_limits(angles: np.ndarray) -> Limits:
    """Return the limits of angles (frames, pairs) in radians, all frames of the training motion together."""
    low, high = np.quantile(np.asarray(angles, np.float64), QUANTILES, axis=0)
    return Limits(low, high)


def violation_counts(angles: np.ndarray, limits: Limits, *, first_frame: int = SEED_FRAMES) -> np.ndarray:
    """Count the violations of one clip, from which the ratios of any set of clips follow.

    Args:
        angles: (T, pairs) radians, from `skeleton.joint_angles` of float64 directions.
        limits: limits from `training_limits`.
        first_frame: first frame that is scored; those before it were given to the model.

    Returns:
        (2 + pairs,) numbers of frames, of frames with any angle outside, and of frames with each angle outside.
    """
    scored = np.asarray(angles, np.float64)[first_frame:]
    is_outside = (scored < limits.low - _ROUNDING) | (scored > limits.high + _ROUNDING)
    return np.array([len(scored), is_outside.any(axis=1).sum(), *is_outside.sum(axis=0)], np.float64)


def violations(counts: np.ndarray) -> Violations:
    """Return the violations of clips from the sum (2 + pairs,) of their `violation_counts`."""
    frames, any_outside, *outside = counts
    if not frames:
        return Violations(np.nan, np.nan, 0, np.nan)
    each = np.array(outside) / frames
    worst = int(each.argmax())
    return Violations(float(each.mean()), float(each[worst]), worst, float(any_outside / frames))


def _usual_limits(reference: Reference) -> Limits:
    """Return the limits of the training motion; none where an angle is rigid, which the least change would break."""
    clips = [joint_angles(reference.skeleton, np.asarray(clip, np.float64)) for clip in reference.training]
    low, high = training_limits(np.concatenate(clips))
    is_rigid = high - low < _RIGID
    return Limits(np.where(is_rigid, -np.inf, low), np.where(is_rigid, np.inf, high))


def _counts_by_recording(row: Row) -> np.ndarray:
    reference = row.reference
    limits = reference.once(_usual_limits)
    counts = np.zeros((reference.num_recordings, 2 + len(reference.skeleton.angle_pairs)))
    for directions, member in zip(row.directions, row.members, strict=True):
        counts[member] += violation_counts(joint_angles(reference.skeleton, np.asarray(directions, np.float64)), limits)
    return counts


def _mean(row: Row) -> Statistic:
    counts = row.once(_counts_by_recording)
    return lambda drawn: violations(drawn @ counts).mean


def _worst(row: Row) -> Statistic:
    counts = row.once(_counts_by_recording)
    return lambda drawn: violations(drawn @ counts).worst


def _any(row: Row) -> Statistic:
    counts = row.once(_counts_by_recording)
    return lambda drawn: violations(drawn @ counts).any


LIMITS_MEAN = Metric("limits_mean", "beyond limits", "", "lower", MOVEMENT, 3, _mean)
LIMITS_WORST = Metric("limits_worst", "worst angle", "", "lower", MOVEMENT, 3, _worst)
LIMITS_ANY = Metric("limits_any", "any angle", "", "lower", MOVEMENT, 3, _any)
