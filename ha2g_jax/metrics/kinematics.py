"""Acceleration, jerk and spread of a motion, without regard to the speech.

Other evaluations report these (GENEA, Audio2Gestures). None is a score of quality: a value means something beside that
of the real motion. All joints that are given count; units are those of the positions.
"""

from collections.abc import Callable

import numpy as np

from ha2g_jax.metrics.metric import BEATS, LIKENESS, MOVEMENT, Metric, Statistic
from ha2g_jax.metrics.row import SEED_FRAMES, Row, mean_over_clips, ratio


def acceleration(positions: np.ndarray, fps: float, *, first_frame: int = 4) -> float:
    """Compute the mean length of the second difference of joint positions x fps^2 (GENEA's average acceleration).

    Args:
        positions: (T, joints, 3).
        fps: frames per second.
        first_frame: first frame that is scored; those before it were given to the model.

    Returns:
        A number in units of the positions per s^2; NaN where fewer than 3 frames are scored.
    """
    return _mean_difference(positions, 2, fps, first_frame)


def jerk(positions: np.ndarray, fps: float, *, first_frame: int = 4) -> float:
    """Compute the mean length of the third difference of joint positions x fps^3 (GENEA's average jerk).

    Args:
        positions: (T, joints, 3).
        fps: frames per second.
        first_frame: first frame that is scored; those before it were given to the model.

    Returns:
        A number in units of the positions per s^3; NaN where fewer than 4 frames are scored.
    """
    return _mean_difference(positions, 3, fps, first_frame)


def l1_diversity(values: np.ndarray, *, first_frame: int = 4) -> float:
    """Compute the spread of a sequence around the mean, (1/T) sum_t sum_d |x_td - mean_t x_d| (Audio2Gestures, 2021).

    Args:
        values: (T, ...) positions or directions.
        first_frame: first frame that is scored; those before it were given to the model.

    Returns:
        A number in units of the values, summed over all dimensions, 0 for motion that stands still; NaN without a
        scored frame. Clips are averaged with their scored frames as weights.
    """
    scored = np.asarray(values, np.float64)[first_frame:]
    scored = scored.reshape(len(scored), -1) if len(scored) else scored
    return float(np.mean(np.sum(np.abs(scored - scored.mean(axis=0)), axis=1))) if len(scored) else np.nan


def _mean_difference(positions: np.ndarray, order: int, fps: float, first_frame: int) -> float:
    scored = np.asarray(positions, np.float64)[first_frame:]
    if len(scored) <= order:
        return np.nan
    return float(np.mean(np.linalg.norm(np.diff(scored, n=order, axis=0), axis=-1)) * fps**order)


def _by_frames(function: Callable[..., float]) -> Callable[[Row], Statistic]:
    """Return a measure: the mean over clips, by scored frames, of a function of joint positions and fps."""

    def measure(row: Row) -> Statistic:
        values = [function(positions, row.reference.fps, first_frame=SEED_FRAMES) for positions in row.positions]
        return mean_over_clips(row, values, row.num_scored)

    return measure


def _over_truth(measure: Callable[[Row], Statistic]) -> Callable[[Row], Statistic]:
    """Return a measure: the value of a row over that of ground truth."""
    return lambda row: ratio(measure(row), row.reference.truth.once(measure))


def _spread(row: Row) -> Statistic:
    values = [l1_diversity(directions, first_frame=SEED_FRAMES) for directions in row.directions]
    return mean_over_clips(row, values, row.num_scored)


_acceleration, _jerk = _by_frames(acceleration), _by_frames(jerk)

L1_DIVERSITY = Metric("l1_diversity", "L1 diversity", "", "higher", LIKENESS, 2, _spread, is_paired=True)
ACCELERATION = Metric("acceleration", "acc.", "m/s²", "none", MOVEMENT, 2, _acceleration, is_paired=True)
ACCELERATION_RATIO = Metric("acceleration_ratio", "acc. / truth", "", "none", MOVEMENT, 2, _over_truth(_acceleration))
JERK = Metric("jerk", "jerk", "m/s³", "none", MOVEMENT, 1, _jerk, is_paired=True)
JERK_RATIO = Metric("jerk_ratio", "jerk / truth", "", "none", BEATS, 2, _over_truth(_jerk))
