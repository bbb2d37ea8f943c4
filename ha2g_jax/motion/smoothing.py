"""Motion without its jitter, and no later than before."""

import math

import numpy as np

from ha2g_jax.errors import UserError

MAX_SMOOTHING = 2.0  # seconds
_MIN_LENGTH = 1e-6  # of a mean of directions that has a direction


def smooth(directions: np.ndarray, fps: float, seconds: float) -> np.ndarray:
    """Each pose becomes the mean of those around it, with the weights of a raised cosine (Hann), at unit length.

    The weights are the same before and after a frame: strokes stay where they are in time, and a steady turn stays as
    it is. Near an end the window is as narrow as the nearer end allows, so the first and the last pose stay. Whoever
    hears the frames one by one waits for half the window: that is the delay of the same smoothing in a stream.

    Args:
        directions: (T, bones, 3) unit vectors.
        fps: frames per second.
        seconds: width of the window; one of no more than 2 frames changes nothing.

    Returns:
        (T, bones, 3) float32 unit vectors; the input itself where nothing changes.

    Raises:
        UserError: a width that is no number from 0 to 2.
    """
    check_width(seconds)
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
    return _to_unit(means, poses).astype(np.float32)


def minimum_jerk(share: np.ndarray) -> np.ndarray:
    """A course from 0 at a share 0 to 1 at 1, that begins and ends at rest (Flash and Hogan 1985)."""
    return share**3 * (10 - 15 * share + 6 * share**2)


def check_width(seconds: float) -> None:
    """Raises UserError for a width that `smooth` does not take."""
    if not (math.isfinite(seconds) and 0 <= seconds <= MAX_SMOOTHING):
        raise UserError(f"a smoothing of {seconds} s; expected 0 to {MAX_SMOOTHING:g}")


def slow_mean(poses: np.ndarray, fps: float, seconds: float) -> np.ndarray:
    """The posture that a motion moves about: the mean of the poses around each, under a Hann window.

    Unlike `smooth`, the window keeps its width at the ends, where one half of it is empty.

    Args:
        poses: (T, ..., n) unit vectors or, with signs that do not jump, quaternions.
        fps: frames per second.
        seconds: width of the window.

    Returns:
        (T, ..., n) float64 unit vectors.
    """
    poses = np.asarray(poses, np.float64)
    reach = math.ceil(seconds * fps / 2) - 1
    if reach < 1:
        return poses
    padded = np.pad(poses, ((reach, reach), *((0, 0),) * (poses.ndim - 1)))
    return _to_unit(_sums(padded, _weights(reach, seconds * fps)), poses)


def _to_unit(means: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """Means at unit length; a pose where the directions around it are opposite and have no mean."""
    lengths = np.linalg.norm(means, axis=-1, keepdims=True)
    is_clear = lengths > _MIN_LENGTH
    return np.where(is_clear, means / np.where(is_clear, lengths, 1), poses)


def _weights(reach: int, width: float) -> np.ndarray:
    """(2 reach + 1,) weights of the frames around one, their sum 1; narrower than `width` frames near an end."""
    offsets = np.arange(-reach, reach + 1)
    weights = np.cos(np.pi * offsets / min(width, 2 * (reach + 1))) ** 2
    return weights / weights.sum()


def _sums(poses: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Weighted sums over each window of poses (T, ...), (T - len(weights) + 1, ...), by fast convolution."""
    from scipy import signal

    return signal.oaconvolve(poses, weights.reshape(-1, *[1] * (poses.ndim - 1)), mode="valid", axes=0)
