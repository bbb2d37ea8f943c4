"""Direction vectors at other moments than those of their frames, interpolated on the sphere."""

import numpy as np

# Below this angle a straight line and the great circle agree to float precision; above the other, the great circle
# between two opposite vectors is not defined.
_MIN_ANGLE = 1e-4
_MAX_ANGLE = np.pi - 1e-3
# A bone that turns further than this from one frame to the next did not move there on a curve that could be known.
_MAX_STEP = np.pi / 2
_CHUNK = 4096  # moments at a time, so that half an hour at 240 frames a second needs no more memory than a minute


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


def log_map(base: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """The turns from unit vectors to others, tangent at `base`: (..., 3), their length the angle in radians.

    Between opposite vectors no turn is the shortest; there it is 0.
    """
    chord = np.linalg.norm(vectors - base, axis=-1, keepdims=True)
    angle = 2 * np.arctan2(chord, np.linalg.norm(vectors + base, axis=-1, keepdims=True))
    across = vectors - np.sum(base * vectors, axis=-1, keepdims=True) * base
    is_clear = angle < _MAX_ANGLE
    return np.where(is_clear, across / np.where(is_clear, np.sinc(angle / np.pi), 1), 0)


def exp_map(base: np.ndarray, turns: np.ndarray) -> np.ndarray:
    """The unit vectors (..., 3) that `log_map` gives these turns for."""
    angle = np.linalg.norm(turns, axis=-1, keepdims=True)
    return np.cos(angle) * base + np.sinc(angle / np.pi) * turns


def resample(directions: np.ndarray, fps: float, new_fps: float, new_frames: int) -> np.ndarray:
    """The motion at another frame rate; frame k shows the time k / fps.

    Args:
        directions: (T, bones, 3) unit vectors.
        fps: frames per second of `directions`.
        new_fps: frames per second of the result.
        new_frames: frames of the result; past the last frame the last pose is held.

    Returns:
        (new_frames, bones, 3) float32 unit vectors, those of `sample`.
    """
    return sample(directions, np.arange(new_frames) * (fps / new_fps))


def sample(directions: np.ndarray, places: np.ndarray) -> np.ndarray:
    """The motion at any moments, on a curve through its poses whose velocity is continuous.

    Between two poses it is a cubic Hermite curve: the great circle between them, plus what turns its velocities at both
    ends into those of the poses, normalised. The velocity at a pose is the mean of the turns from the pose before
    and to the pose after it (Catmull and Rom 1974, with turns on the sphere in place of differences). A steady turn
    stays steady, and four poses decide about each moment, so that a pose is heard of two frames away at most.

    Args:
        directions: (T, bones, 3) unit vectors.
        places: (n,) moments in frames; before the first and after the last pose these are held.

    Returns:
        (n, bones, 3) float32 unit vectors; a pose itself at its own place.
    """
    poses = np.asarray(directions, np.float32)
    places = np.clip(places, 0, len(poses) - 1)
    before = np.minimum(places.astype(int), max(len(poses) - 2, 0))
    sampled = np.empty((len(places), *poses.shape[1:]), np.float32)
    for start in range(0, len(places), _CHUNK):
        rows = before[start : start + _CHUNK]
        fraction = (places[start : start + _CHUNK] - rows)[:, None, None]
        sampled[start : start + _CHUNK] = _curve(poses, rows, fraction)
    return sampled


def _curve(poses: np.ndarray, before: np.ndarray, fraction: np.ndarray) -> np.ndarray:
    """The curve of `sample` between the poses `before` and those after them, (n, bones, 3) float64."""
    last = len(poses) - 1
    rows = (before - 1, before, np.minimum(before + 1, last), before + 2)
    earlier, first, second, later = (poses[np.clip(row, 0, last)].astype(np.float64) for row in rows)
    out, arriving = log_map(first, second), -log_map(second, first)
    # An end has one neighbour; a velocity as if the turn there went on is that of the great circle.
    bend_out = np.where((rows[0] < 0)[:, None, None], 0, (-log_map(first, earlier) - out) / 2)
    bend_in = np.where((rows[3] > last)[:, None, None], 0, (log_map(second, later) - arriving) / 2)
    bends = fraction * (1 - fraction) * ((1 - fraction) * bend_out - fraction * bend_in)
    is_smooth = np.linalg.norm(out, axis=-1, keepdims=True) < _MAX_STEP
    curve = slerp(first, second, fraction) + np.where(is_smooth, bends, 0)
    curve /= np.linalg.norm(curve, axis=-1, keepdims=True)
    return np.where(fraction == 0, first, np.where(fraction == 1, second, curve))
