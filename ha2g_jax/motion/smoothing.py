"""Smoothing of a motion over time, without delay."""

import math

import numpy as np
import numpy.typing as npt

from ha2g_jax.errors import check_number

MAX_SMOOTHING = 2.0  # seconds
_MIN_LENGTH = 1e-6  # a mean of directions shorter than this has no direction


def smooth(directions: np.ndarray, fps: float, seconds: float) -> np.ndarray:
    """Replace each pose by the normalised mean of the poses around it, weighted by a raised cosine (Hann window).

    The window is symmetric: strokes keep their times, and a rotation of constant speed does not change. Near an end
    the window is as narrow as the nearer end allows, so that the first and the last pose do not change. The same
    smoothing of a stream needs a delay of half the window.

    Args:
        directions: (T, bones, 3) unit vectors.
        seconds: width of the window in seconds; one of at most 2 frames changes nothing.

    Returns:
        (T, bones, 3) float32 unit vectors; the input itself where nothing changes.

    Raises:
        UserError: the width is not a number from 0 to 2.
    """
    seconds = check_width(seconds)
    reach = math.ceil(seconds * fps / 2) - 1  # frames on either side whose weight is not 0
    if reach < 1 or len(directions) < 3:
        return directions
    poses = np.asarray(directions, np.float64)
    means = poses.copy()
    frames = len(poses)
    for edge in range(1, min(reach, (frames + 1) // 2)):
        for frame in {edge, frames - 1 - edge}:
            means[frame] = np.tensordot(_weights(edge, seconds * fps), poses[frame - edge : frame + edge + 1], 1)
    if frames > 2 * reach:
        means[reach : frames - reach] = _sums(poses, _weights(reach, seconds * fps))
    return to_unit(means, poses).astype(np.float32)


def minimum_jerk(time: np.ndarray) -> np.ndarray:
    """Return the minimum-jerk curve, which goes from 0 to 1 and is at rest at both ends (Flash and Hogan 1985)."""
    return time**3 * (10 - 15 * time + 6 * time**2)


def smoothstep(values: npt.ArrayLike, start: float, end: float) -> np.ndarray:
    """Return a smooth step of values of any shape: 0 up to `start`, 1 from `end` on."""
    fraction = np.clip((np.asarray(values) - start) / (end - start), 0, 1)
    return fraction * fraction * (3 - 2 * fraction)


def check_width(seconds: float) -> float:
    """Return the width in seconds of the window of `smooth`; raise a UserError if it is not a number from 0 to 2."""
    message = f"the smoothing window is {seconds} s; expected 0 to {MAX_SMOOTHING:g}"
    return check_number(seconds, 0, MAX_SMOOTHING, message)


def slow_mean(poses: np.ndarray, fps: float, seconds: float) -> np.ndarray:
    """Return the mean of the poses around each pose, weighted by a Hann window: the posture about which motion moves.

    Unlike in `smooth`, the window keeps its width at the ends, where one half of it is empty. The poses (T, ..., n) are
    unit vectors, or quaternions with signs that are continuous over time.
    """
    poses = np.asarray(poses, np.float64)
    reach = math.ceil(seconds * fps / 2) - 1
    if reach < 1 or not len(poses):
        return poses
    padded = np.pad(poses, ((reach, reach), *((0, 0),) * (poses.ndim - 1)))
    return to_unit(_sums(padded, _weights(reach, seconds * fps)), poses)


def to_unit(means: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """Return means (..., n) scaled to length 1; the pose in place of one that is too short to have a direction."""
    lengths = np.linalg.norm(means, axis=-1, keepdims=True)
    is_clear = lengths > _MIN_LENGTH
    return np.where(is_clear, means / np.where(is_clear, lengths, 1), poses)


def _weights(reach: int, width: float) -> np.ndarray:
    """Return (2 reach + 1,) weights with sum 1 of the frames around a frame; near an end narrower than `width`."""
    offsets = np.arange(-reach, reach + 1)
    weights = np.cos(np.pi * offsets / min(width, 2 * (reach + 1))) ** 2
    return weights / weights.sum()


def _sums(poses: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return weighted sums (T - len(weights) + 1, ...) over each window of poses (T, ...) by fast convolution."""
    from scipy import signal

    return signal.oaconvolve(poses, weights.reshape(-1, *[1] * (poses.ndim - 1)), mode="valid", axes=0)
