"""Errors of reconstruction: distances of a motion from the recorded one. A good gesture may be another one."""

from collections.abc import Callable

import numpy as np

from ha2g_jax.metrics.metric import RECONSTRUCTION, Metric, Statistic
from ha2g_jax.metrics.row import SEED_FRAMES, Row, mean_over_clips

DELTA = 0.1  # metres within which a joint counts as found


def joint_mae(generated: np.ndarray, real: np.ndarray, *, first_frame: int = SEED_FRAMES) -> float:
    """Compute the mean of |p_hat - p| over frames, joints (the root among them) and coordinates.

    Args:
        generated, real: (..., T, joints, 3) positions.
        first_frame: first frame that is scored; those before it were given to the model.

    Returns:
        The error in units of the positions; NaN where no frame is scored.
    """
    return _mean_absolute(_difference(generated, real, first_frame))


def acceleration_error(generated: np.ndarray, real: np.ndarray, fps: float, *, first_frame: int = SEED_FRAMES) -> float:
    """Compute the mean of |difference of the second differences of positions| x fps^2.

    Args:
        generated, real: (..., T, joints, 3) positions.
        fps: frames per second.
        first_frame: first frame that is scored; those before it were given to the model.

    Returns:
        The error in units of the positions per s^2; NaN where fewer than 3 frames are scored.
    """
    difference = _difference(generated, real, first_frame)
    return np.nan if difference.shape[-3] < 3 else _mean_absolute(np.diff(difference, n=2, axis=-3) * fps**2)


def pck(generated: np.ndarray, real: np.ndarray, *, delta: float = DELTA, first_frame: int = SEED_FRAMES) -> float:
    """Compute PCK, the ratio of joints in all frames whose L1 error is below delta.

    Without semantic weights of the frames it equals the semantic-relevant gesture recall of BEAT (Liu et al., 2022).

    Args:
        generated, real: (T, joints, 3) positions.
        delta: distance in units of the positions, summed over the coordinates.
        first_frame: first frame that is scored; those before it were given to the model.

    Returns:
        A number in [0, 1]; NaN where no frame is scored.
    """
    errors = np.abs(_difference(generated, real, first_frame)).sum(axis=-1)
    return float(np.mean(errors < delta)) if errors.size else np.nan


def _difference(generated: np.ndarray, real: np.ndarray, first_frame: int) -> np.ndarray:
    return (np.asarray(generated, np.float64) - np.asarray(real, np.float64))[..., first_frame:, :, :]


def _mean_absolute(values: np.ndarray) -> float:
    return float(np.mean(np.abs(values))) if values.size else np.nan


def _to_counterpart(function: Callable[..., float]) -> Callable[[Row], Statistic | None]:
    """Return a measure: the mean over clips, by scored frames, of a function of positions and of the true ones."""

    def measure(row: Row) -> Statistic | None:
        if not row.has_counterpart:
            return None
        values = [
            function(own, true, row.reference.fps) for own, true in zip(row.positions, row.true_positions, strict=True)
        ]
        return mean_over_clips(row, values, row.num_scored)

    return measure


JOINT_MAE = Metric(
    "joint_mae",
    "joint MAE",
    "m",
    "lower",
    RECONSTRUCTION,
    4,
    _to_counterpart(lambda own, true, fps: joint_mae(own, true)),
    is_paired=True,
)
ACCELERATION_ERROR = Metric(
    "acceleration_error", "acc. error", "m/s²", "lower", RECONSTRUCTION, 2, _to_counterpart(acceleration_error)
)
PCK = Metric(
    "pck",
    "PCK",
    "",
    "higher",
    RECONSTRUCTION,
    3,
    _to_counterpart(lambda own, true, fps: pck(own, true)),
    is_paired=True,
)
