"""Resampling of direction vectors in time by interpolation on the sphere."""

import numpy as np

# Below this angle a straight line and the great circle agree to float precision; above the other, the great circle
# between two opposite vectors is not defined.
_MIN_ANGLE = 1e-4
_MAX_ANGLE = np.pi - 1e-3
# Where a bone rotates further than this from one frame to the next, the curve between the frames cannot be known.
_MAX_STEP = np.pi / 2
_CHUNK = 4096  # frames at a time, so that half an hour at 240 frames per second needs no more memory than a minute


def num_frames(duration: float, fps: float) -> int:
    """Return the number of frames of a motion of a duration in seconds: round(duration x fps), at least 1."""
    return max(1, round(duration * fps))


def moments_at(frames: int, fps: float, new_fps: float) -> np.ndarray:
    """Return the moments (T,) in frames at which a motion is sampled at another rate, T of `num_frames`.

    After the last frame that frame is held.
    """
    return np.minimum(np.arange(num_frames(frames / fps, new_fps)) * (fps / new_fps), frames - 1)


def angles(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the angles (..., 1) in radians between unit vectors (..., 3), as exact near 0 as near 180 degrees."""
    chord = np.linalg.norm(first - second, axis=-1, keepdims=True)
    return 2 * np.arctan2(chord, np.linalg.norm(first + second, axis=-1, keepdims=True))


def slerp(first: np.ndarray, second: np.ndarray, fraction: np.ndarray) -> np.ndarray:
    """Interpolate between unit vectors (..., 3) on the sphere.

    The fraction, which broadcasts with (..., 1), is 0 at `first` and 1 at `second`. Between opposite vectors, which
    have no shortest arc, the result is the nearer of the two.
    """
    angle = angles(first, second)
    safe = np.where((angle > _MIN_ANGLE) & (angle < _MAX_ANGLE), angle, 1)
    mixed = (np.sin((1 - fraction) * safe) * first + np.sin(fraction * safe) * second) / np.sin(safe)
    straight = (1 - fraction) * first + fraction * second
    nearer = np.where(fraction < 0.5, first, second)
    mixed = np.where(angle <= _MIN_ANGLE, straight, np.where(angle >= _MAX_ANGLE, nearer, mixed))
    return mixed / np.linalg.norm(mixed, axis=-1, keepdims=True)


def log_map(base: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Return tangents (..., 3) at `base` to unit vectors, as long as the angles in radians, 0 for opposite ones."""
    angle = angles(base, vectors)
    across = vectors - np.sum(base * vectors, axis=-1, keepdims=True) * base
    is_clear = angle < _MAX_ANGLE
    return np.where(is_clear, across / np.where(is_clear, np.sinc(angle / np.pi), 1), 0)


def exp_map(base: np.ndarray, tangents: np.ndarray) -> np.ndarray:
    """Return the unit vectors (..., 3) that tangent vectors at `base` lead to, the inverse of `log_map`."""
    angle = np.linalg.norm(tangents, axis=-1, keepdims=True)
    return np.cos(angle) * base + np.sinc(angle / np.pi) * tangents


def resample(directions: np.ndarray, fps: float, new_fps: float, new_frames: int) -> np.ndarray:
    """Resample unit vectors (T, bones, 3) by `sample` at times k / new_fps; the last pose is held to the end."""
    return sample(directions, np.arange(new_frames) * (fps / new_fps))


def sample(directions: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Sample a motion at any times on a curve through its poses whose velocity is continuous.

    Between two poses it is a cubic Hermite curve: the great circle between them plus a term that adjusts the
    velocities at both ends, normalised. The velocity at a pose is the mean of the tangents from the pose before and to
    the pose after it (Catmull and Rom 1974, with tangents on the sphere in place of differences). A rotation of
    constant speed stays one. Each moment depends on four poses, so that a pose has an effect up to two frames away.

    Args:
        directions: (T, bones, 3) unit vectors.
        places: (n,) moments in frames; before the first and after the last pose that pose is held.

    Returns:
        (n, bones, 3) float32 unit vectors; at the moment of a frame exactly its pose.
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
    """Return the curve of `sample` between the poses `before` and those after them, (n, bones, 3) float64."""
    last = len(poses) - 1
    rows = (before - 1, before, np.minimum(before + 1, last), before + 2)
    earlier, first, second, later = (poses[np.clip(row, 0, last)].astype(np.float64) for row in rows)
    out, arriving = log_map(first, second), -log_map(second, first)
    # An end has one neighbour; its velocity is that of the great circle to it.
    bend_out = np.where((rows[0] < 0)[:, None, None], 0, (-log_map(first, earlier) - out) / 2)
    bend_in = np.where((rows[3] > last)[:, None, None], 0, (log_map(second, later) - arriving) / 2)
    bends = fraction * (1 - fraction) * ((1 - fraction) * bend_out - fraction * bend_in)
    is_smooth = np.linalg.norm(out, axis=-1, keepdims=True) < _MAX_STEP
    curve = slerp(first, second, fraction) + np.where(is_smooth, bends, 0)
    curve /= np.linalg.norm(curve, axis=-1, keepdims=True)
    return np.where(fraction == 0, first, np.where(fraction == 1, second, curve))
