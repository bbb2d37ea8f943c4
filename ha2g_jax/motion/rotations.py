"""Rotations as unit quaternions: numpy (..., 4), float64, in the order x, y, z, w (that of glTF and scipy).

`multiply(a, b)` rotates by b first, then by a. A quaternion and its negative are the same rotation.
"""

import warnings
from typing import Any

import numpy as np
import numpy.typing as npt

IDENTITY = np.array([0.0, 0.0, 0.0, 1.0])

# Below this length a vector has no direction.
_MIN_NORM = 1e-12


def multiply(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the rotation b followed by the rotation a, of quaternions (..., 4) whose shapes broadcast."""
    (ax, ay, az, aw), (bx, by, bz, bw) = ([q[..., k] for k in range(4)] for q in (a, b))
    return np.stack(
        [
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz,
        ],
        axis=-1,
    )


def conjugate(q: np.ndarray) -> np.ndarray:
    """Return the inverse rotations (..., 4) of unit quaternions (..., 4)."""
    return q * np.array([-1.0, -1.0, -1.0, 1.0])


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the cross products of vectors (..., 3), as `np.cross`, which takes longer for few of them."""
    yzx, zxy = [1, 2, 0], [2, 0, 1]
    return a.take(yzx, axis=-1) * b.take(zxy, axis=-1) - a.take(zxy, axis=-1) * b.take(yzx, axis=-1)


def rotate(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return vectors v (..., 3) rotated by unit quaternions q (..., 4)."""
    axis, w = q[..., :3], q[..., 3:]
    twice = 2 * cross(axis, v)
    return v + w * twice + cross(axis, twice)


def unit(vectors: np.ndarray) -> np.ndarray:
    """Return vectors (..., n) scaled to length 1; a zero vector stays zero."""
    vectors = np.asarray(vectors, np.float64)
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), _MIN_NORM)


def perpendicular(v: np.ndarray) -> np.ndarray:
    """Return a unit vector at right angles to each of v (..., 3), the cross product with the axis farthest from v."""
    least = np.eye(3)[np.argmin(np.abs(v), axis=-1)]
    return unit(cross(v, least))


def between(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return the shortest rotations (..., 4) from u to v, (..., 3) vectors of any positive length.

    Between opposite vectors it is a rotation by 180 degrees about `perpendicular(u)`.
    """
    u, v = np.broadcast_arrays(unit(u), unit(v))
    half = u + v
    is_opposite = np.linalg.norm(half, axis=-1, keepdims=True) < 1e-7
    middle = unit(half)
    if is_opposite.any():
        middle = np.where(is_opposite, perpendicular(u), middle)
    return unit(np.concatenate([cross(u, middle), np.sum(u * middle, axis=-1, keepdims=True)], axis=-1))


def fit(seen: np.ndarray, rest: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Fit the rotations from directions at rest to observed directions by least squares (Wahba's problem).

    They follow from the singular value decomposition of sum seen rest^T (F. L. Markley, "Attitude determination using
    vector observations and the singular value decomposition", 1988), for unit vectors (T, k, 3) and (k, 3) at rest.

    Returns:
        (T, 4) rotations, and (T,) certainties from 0, where all directions lie on one line, to 1, where they lie to
        each other as at rest.
    """
    u, sizes, vt = np.linalg.svd(np.einsum("tki,kj->tij", seen, rest))
    sign = np.where(np.linalg.det(u) * np.linalg.det(vt) < 0, -1.0, 1.0)
    u[..., 2] *= sign[:, None]
    _, second, third = np.linalg.svd(np.einsum("ki,kj->ij", rest, rest), compute_uv=False)
    certainty = (sizes[:, 1] + sign * sizes[:, 2]) / np.maximum(second + third, _MIN_NORM)
    return from_matrix(u @ vt), np.clip(certainty, 0, 1)


def about(axis: np.ndarray, angle: npt.ArrayLike) -> np.ndarray:
    """Return right-handed rotations (..., 4) about unit axes (..., 3) by angles (...) in radians."""
    half = np.asarray(angle, np.float64)[..., None] / 2
    axis = np.asarray(axis, np.float64)
    shape = np.broadcast_shapes(half.shape[:-1], axis.shape[:-1])
    imaginary = np.broadcast_to(axis * np.sin(half), (*shape, 3))
    return np.concatenate([imaginary, np.broadcast_to(np.cos(half), (*shape, 1))], axis=-1)


def to_matrix(q: np.ndarray) -> np.ndarray:
    """Return rotation matrices (..., 3, 3) of quaternions (..., 4); the columns are the rotated x, y and z axes."""
    return np.stack([rotate(q, axis) for axis in np.eye(3)], axis=-1)


def from_matrix(matrices: np.ndarray) -> np.ndarray:
    """Return quaternions (..., 4) with w >= 0 of rotation matrices (..., 3, 3)."""
    matrices = np.asarray(matrices, np.float64)
    q = _scipy_rotation().from_matrix(matrices.reshape(-1, 3, 3)).as_quat(canonical=True)
    return q.reshape(*matrices.shape[:-2], 4)


def to_euler(q: np.ndarray, order: str = "ZXY") -> np.ndarray:
    """Return intrinsic Euler angles (..., 3) in degrees of quaternions (..., 4) about the axes that `order` names."""
    q = np.asarray(q, np.float64)
    with warnings.catch_warnings():
        # At the pole only a sum of angles is defined; scipy sets the third to 0 and says so.
        warnings.filterwarnings("ignore", message="Gimbal lock", category=UserWarning)
        angles = _scipy_rotation().from_quat(q.reshape(-1, 4)).as_euler(order, degrees=True)
    return angles.reshape(*q.shape[:-1], 3)


def from_euler(angles: np.ndarray, order: str = "ZXY") -> np.ndarray:
    """Return the quaternions (..., 4) of intrinsic Euler angles (..., 3) in degrees, the inverse of `to_euler`."""
    angles = np.asarray(angles, np.float64)
    q = _scipy_rotation().from_euler(order, angles.reshape(-1, 3), degrees=True).as_quat()
    return q.reshape(*angles.shape[:-1], 4)


def prepare() -> None:
    """Import what `fit`, `from_matrix` and Euler angles need, for a motion in which no frame may wait for it."""
    _scipy_rotation()


def _scipy_rotation() -> Any:
    from scipy.spatial.transform import Rotation  # its import takes half a second; a motion of the model needs none

    return Rotation


def to_vector(q: np.ndarray) -> np.ndarray:
    """Return axis-angle vectors (..., 3) of quaternions (..., 4): the axis times the angle in radians, 0 to pi."""
    sign = np.where(q[..., 3:] < 0, -1.0, 1.0)
    axis, w = q[..., :3] * sign, q[..., 3:] * sign
    length = np.linalg.norm(axis, axis=-1, keepdims=True)
    angle = 2 * np.arctan2(length, w)
    return axis * np.where(length > _MIN_NORM, angle / np.maximum(length, _MIN_NORM), 2.0)


def from_vector(vectors: np.ndarray) -> np.ndarray:
    """Return quaternions (..., 4) of axis-angle vectors (..., 3) in radians."""
    angle = np.linalg.norm(vectors, axis=-1)
    return about(unit(vectors), angle)


def continuous(q: np.ndarray, before: np.ndarray | None = None) -> np.ndarray:
    """Choose continuous signs of quaternions (T, ..., 4) from the frame `before` on, or from w >= 0 without one."""
    q = np.array(q, np.float64)
    flips = np.sum(q[1:] * q[:-1], axis=-1) < 0
    first = q[:1, ..., 3] < 0 if before is None else np.sum(q[:1] * before, axis=-1) < 0
    sign = np.where(np.cumsum(np.concatenate([first, flips]), axis=0) % 2 == 1, -1.0, 1.0)
    return q * sign[..., None]


def split_twist(q: np.ndarray, axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Split rotations (..., 4) into swing and twist, q = swing x twist.

    The twist rotates about `axis`, (..., 3) unit vectors; the swing is the shortest rotation from there to where q
    takes the axis. Where q reverses the axis, the twist is the identity.
    """
    along = np.sum(q[..., :3] * axis, axis=-1, keepdims=True)
    twist = np.concatenate([along * axis, q[..., 3:]], axis=-1)
    norm = np.linalg.norm(twist, axis=-1, keepdims=True)
    twist = np.where(norm > 1e-9, twist / np.maximum(norm, 1e-9), IDENTITY)
    return multiply(q, conjugate(twist)), twist


def twist_angle(q: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Return the angles (...) in radians, -pi to pi, of the twist of `split_twist`."""
    _, twist = split_twist(q, axis)
    angle = 2 * np.arctan2(np.sum(twist[..., :3] * axis, axis=-1), twist[..., 3])
    return (angle + np.pi) % (2 * np.pi) - np.pi


def slerp(a: np.ndarray, b: np.ndarray, fraction: npt.ArrayLike) -> np.ndarray:
    """Interpolate between rotations (..., 4) along the shorter arc; the fraction (...) 0 gives `a`, 1 gives `b`."""
    b = np.where(np.sum(a * b, axis=-1, keepdims=True) < 0, -b, b)
    difference = to_vector(multiply(b, conjugate(a)))
    return multiply(from_vector(np.asarray(fraction, np.float64)[..., None] * difference), a)


def angle_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the angles (...) in radians, 0 to pi, of the rotations from a (..., 4) to b (..., 4)."""
    return np.linalg.norm(to_vector(multiply(b, conjugate(a))), axis=-1)
