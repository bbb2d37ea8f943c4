"""Does the body bend as bodies do? Angles outside the range of the training motion, and bones of the wrong length."""

from typing import NamedTuple

import numpy as np

QUANTILES = (0.001, 0.999)
NUM_DEVIATIONS = 3

_ROUNDING = 1e-6  # radians by which an angle may lie outside: two ways of rounding the same pose


class Limits(NamedTuple):
    """What the training motion does; (pairs,) each, in radians.

    Attributes:
        low, high: the 0.1 % and the 99.9 % quantile of each angle.
        mean, deviation: its mean and standard deviation.
    """

    low: np.ndarray
    high: np.ndarray
    mean: np.ndarray
    deviation: np.ndarray


class Shares(NamedTuple):
    """Shares of frames, in [0, 1]; NaN where no frame is scored.

    Attributes:
        mean: with an angle outside of its limits, mean over angles.
        worst: the same of the angle that is outside most often.
        worst_pair: index of that angle.
        any: with any angle outside.
    """

    mean: float
    worst: float
    worst_pair: int
    any: float


class Violations(NamedTuple):
    """Shares outside of the quantiles, and outside of the mean +- 3 standard deviations."""

    quantiles: Shares
    deviations: Shares


def training_limits(angles: np.ndarray) -> Limits:
    """Limits of angles (frames, pairs) in radians, all frames of the training motion together."""
    angles = np.asarray(angles, np.float64)
    low, high = np.quantile(angles, QUANTILES, axis=0)
    return Limits(low, high, angles.mean(axis=0), angles.std(axis=0))


def violations(angles: np.ndarray, limits: Limits, *, first_frame: int = 4) -> Violations:
    """How often angles (T, pairs) in radians lie outside the limits, see `violation_counts` for many clips."""
    return shares(violation_counts(angles, limits, first_frame=first_frame)[None])


def violation_counts(angles: np.ndarray, limits: Limits, *, first_frame: int = 4) -> np.ndarray:
    """Counts of one clip, from which the shares of any set of clips follow.

    Args:
        angles: (T, pairs) radians, from `skeleton.joint_angles` of float64 directions.
        limits: from `training_limits`.
        first_frame: frames before it were given to the model and are not scored.

    Returns:
        (2, 2 + pairs) for the quantiles and for the deviations: frames, frames with any angle outside, and frames with
        each angle outside.
    """
    scored = np.asarray(angles, np.float64)[first_frame:]
    reach = NUM_DEVIATIONS * limits.deviation
    counts = []
    for low, high in ((limits.low, limits.high), (limits.mean - reach, limits.mean + reach)):
        is_outside = (scored < low - _ROUNDING) | (scored > high + _ROUNDING)
        counts.append([len(scored), is_outside.any(axis=1).sum(), *is_outside.sum(axis=0)])
    return np.array(counts, np.float64)


def shares(counts: np.ndarray) -> Violations:
    """Violations over clips, from their `violation_counts` (clips, 2, 2 + pairs)."""
    by_limit = []
    for frames, any_outside, *outside in np.sum(counts, axis=0):
        if not frames:
            by_limit.append(Shares(np.nan, np.nan, 0, np.nan))
            continue
        each = np.array(outside) / frames
        worst = int(each.argmax())
        by_limit.append(Shares(float(each.mean()), float(each[worst]), worst, float(any_outside / frames)))
    return Violations(*by_limit)


def length_error(vectors: np.ndarray, *, first_frame: int = 4) -> float:
    """Mean | |d| - 1 | of direction vectors (T, bones, 3) as a model makes them, before they are normalised.

    0 where every bone keeps its length; NaN where no frame is scored.
    """
    scored = np.asarray(vectors, np.float64)[first_frame:]
    return float(np.mean(np.abs(np.linalg.norm(scored, axis=-1) - 1))) if len(scored) else np.nan
