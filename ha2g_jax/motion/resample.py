"""Direction vectors at another frame rate, interpolated on the sphere."""

import numpy as np

# Below this angle a straight line and the great circle agree to float precision; above the other, the great circle
# between two opposite vectors is not defined.
_MIN_ANGLE = 1e-4
_MAX_ANGLE = np.pi - 1e-3


def num_frames(duration: float, fps: float) -> int:
    """Frames of a motion that lasts `duration` seconds: round(duration x fps), at least 1."""
    return max(1, round(duration * fps))


def slerp(first: np.ndarray, second: np.ndarray, fraction: np.ndarray) -> np.ndarray:
    """Spherical interpolation between unit vectors.

    Args:
        first, second: (..., 3) unit vectors.
        fraction: broadcastable to (..., 1); 0 gives `first`, 1 gives `second`.

    Returns:
        (..., 3) unit vectors. Between opposite vectors there is no shortest way; the nearer of the two is taken.
    """
    chord = np.linalg.norm(first - second, axis=-1, keepdims=True)
    angle = 2 * np.arctan2(chord, np.linalg.norm(first + second, axis=-1, keepdims=True))
    safe = np.where((angle > _MIN_ANGLE) & (angle < _MAX_ANGLE), angle, 1)
    mixed = (np.sin((1 - fraction) * safe) * first + np.sin(fraction * safe) * second) / np.sin(safe)
    straight = (1 - fraction) * first + fraction * second
    nearer = np.where(fraction < 0.5, first, second)
    mixed = np.where(angle <= _MIN_ANGLE, straight, np.where(angle >= _MAX_ANGLE, nearer, mixed))
    return mixed / np.linalg.norm(mixed, axis=-1, keepdims=True)


def resample(directions: np.ndarray, fps: float, new_fps: float, new_frames: int) -> np.ndarray:
    """The motion at another frame rate; frame k shows the time k / fps.

    Args:
        directions: (T, bones, 3) unit vectors.
        fps: frames per second of `directions`.
        new_fps: frames per second of the result.
        new_frames: frames of the result; past the last frame the last pose is held.

    Returns:
        (new_frames, bones, 3) float32 unit vectors.
    """
    time = np.minimum(np.arange(new_frames) * (fps / new_fps), len(directions) - 1)
    before = np.floor(time).astype(int)
    after = np.minimum(before + 1, len(directions) - 1)
    fraction = (time - before).astype(np.float32)[:, None, None]
    return slerp(directions[before], directions[after], fraction).astype(np.float32)
