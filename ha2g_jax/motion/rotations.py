"""Rotations as unit quaternions: numpy (..., 4), float64, in the order x, y, z, w (that of glTF and scipy).

`multiply(a, b)` turns by b first, then by a. A quaternion and its negative are the same rotation.
"""

import warnings

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

IDENTITY = np.array([0.0, 0.0, 0.0, 1.0])

# Below this length a vector has no direction.
_MIN_NORM = 1e-12


def multiply(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The rotation b followed by a, (..., 4) of any shapes that broadcast."""
    (ax, ay, az, aw), (bx, by, bz, bw) = np.moveaxis(a, -1, 0), np.moveaxis(b, -1, 0)
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
    """The rotation back, (..., 4)."""
    return q * np.array([-1.0, -1.0, -1.0, 1.0])


def rotate(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Vectors (..., 3) turned by q (..., 4)."""
    axis, w = q[..., :3], q[..., 3:]
    twice = 2 * np.cross(axis, v)
    return v + w * twice + np.cross(axis, twice)


def unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors (..., n) at length 1; a zero vector stays zero."""
    vectors = np.asarray(vectors, np.float64)
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), _MIN_NORM)


def perpendicular(v: np.ndarray) -> np.ndarray:
    """A unit vector at right angles to each of v (..., 3): across the axis that v is farthest from."""
    least = np.eye(3)[np.argmin(np.abs(v), axis=-1)]
    return unit(np.cross(v, least))


def between(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """The shortest rotation from u to v.

    Args:
        u, v: (..., 3) vectors of any positive length. Between opposite vectors it is half a turn about `perpendicular`.

    Returns:
        (..., 4).
    """
    u, v = np.broadcast_arrays(unit(u), unit(v))
    half = u + v
    is_opposite = np.linalg.norm(half, axis=-1, keepdims=True) < 1e-7
    middle = np.where(is_opposite, perpendicular(u), unit(half))
    return unit(np.concatenate([np.cross(u, middle), np.sum(u * middle, axis=-1, keepdims=True)], axis=-1))


def about(axis: np.ndarray, angle: npt.ArrayLike) -> np.ndarray:
    """Rotations (..., 4) about unit axes (..., 3) by angles (...) in radians, right-handed."""
    half = np.asarray(angle, np.float64)[..., None] / 2
    axis = np.asarray(axis, np.float64)
    shape = np.broadcast_shapes(half.shape[:-1], axis.shape[:-1])
    imaginary = np.broadcast_to(axis * np.sin(half), (*shape, 3))
    return np.concatenate([imaginary, np.broadcast_to(np.cos(half), (*shape, 1))], axis=-1)


def to_matrix(q: np.ndarray) -> np.ndarray:
    """Rotation matrices (..., 3, 3) whose columns are the turned x, y and z axes."""
    return np.stack([rotate(q, axis) for axis in np.eye(3)], axis=-1)


def from_matrix(matrices: np.ndarray) -> np.ndarray:
    """Quaternions (..., 4) of rotation matrices (..., 3, 3), w not negative."""
    matrices = np.asarray(matrices, np.float64)
    q = Rotation.from_matrix(matrices.reshape(-1, 3, 3)).as_quat(canonical=True)
    return q.reshape(*matrices.shape[:-2], 4)


def from_axes(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """The rotations (..., 4) that turn the three axes to x, y and z, right-handed unit vectors (..., 3)."""
    return from_matrix(np.stack([x, y, z], axis=-1))


def to_euler(q: np.ndarray, order: str = "ZXY") -> np.ndarray:
    """Angles (..., 3) in degrees, intrinsic: about the first axis, then about the second as turned by it, and so on."""
    q = np.asarray(q, np.float64)
    with warnings.catch_warnings():
        # At the pole only a sum of angles is defined; scipy sets the third to 0 and says so.
        warnings.filterwarnings("ignore", message="Gimbal lock", category=UserWarning)
        turned = Rotation.from_quat(q.reshape(-1, 4)).as_euler(order, degrees=True)
    return turned.reshape(*q.shape[:-1], 3)


def from_euler(angles: np.ndarray, order: str = "ZXY") -> np.ndarray:
    """Quaternions (..., 4) of the angles of `to_euler`, (..., 3) in degrees."""
    angles = np.asarray(angles, np.float64)
    return Rotation.from_euler(order, angles.reshape(-1, 3), degrees=True).as_quat().reshape(*angles.shape[:-1], 4)


def to_vector(q: np.ndarray) -> np.ndarray:
    """Axis-angle vectors (..., 3): the axis times the angle in radians, from 0 to pi."""
    sign = np.where(q[..., 3:] < 0, -1.0, 1.0)
    axis, w = q[..., :3] * sign, q[..., 3:] * sign
    length = np.linalg.norm(axis, axis=-1, keepdims=True)
    angle = 2 * np.arctan2(length, w)
    return axis * np.where(length > _MIN_NORM, angle / np.maximum(length, _MIN_NORM), 2.0)


def from_vector(vectors: np.ndarray) -> np.ndarray:
    """Quaternions (..., 4) of axis-angle vectors (..., 3) in radians."""
    angle = np.linalg.norm(vectors, axis=-1)
    return about(unit(vectors), angle)


def continuous(q: np.ndarray) -> np.ndarray:
    """The same rotations (T, ..., 4) with signs that do not jump from frame to frame; w >= 0 in the first."""
    q = np.array(q, np.float64)
    flips = np.sum(q[1:] * q[:-1], axis=-1) < 0
    first = q[:1, ..., 3] < 0
    sign = np.where(np.cumsum(np.concatenate([first, flips]), axis=0) % 2 == 1, -1.0, 1.0)
    return q * sign[..., None]


def split_twist(q: np.ndarray, axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """q = swing x twist: a turn about `axis`, then the shortest way to where q takes the axis.

    Args:
        q: (..., 4).
        axis: (..., 3) unit vectors.

    Returns:
        Swing and twist, (..., 4) each. Where q turns the axis round, the twist is none.
    """
    along = np.sum(q[..., :3] * axis, axis=-1, keepdims=True)
    twist = np.concatenate([along * axis, q[..., 3:]], axis=-1)
    norm = np.linalg.norm(twist, axis=-1, keepdims=True)
    twist = np.where(norm > 1e-9, twist / np.maximum(norm, 1e-9), IDENTITY)
    return multiply(q, conjugate(twist)), twist


def twist_angle(q: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Angle (...) in radians, from -pi to pi, of the twist of `split_twist`."""
    _, twist = split_twist(q, axis)
    angle = 2 * np.arctan2(np.sum(twist[..., :3] * axis, axis=-1), twist[..., 3])
    return (angle + np.pi) % (2 * np.pi) - np.pi


def slerp(a: np.ndarray, b: np.ndarray, share: npt.ArrayLike) -> np.ndarray:
    """Rotations (..., 4) on the shorter way from a to b; share (...) is 0 at a and 1 at b."""
    b = np.where(np.sum(a * b, axis=-1, keepdims=True) < 0, -b, b)
    way = to_vector(multiply(b, conjugate(a)))
    return multiply(from_vector(np.asarray(share, np.float64)[..., None] * way), a)


def angle_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Angle (...) in radians, 0 to pi, of the rotation from a to b, (..., 4) each."""
    return np.linalg.norm(to_vector(multiply(b, conjugate(a))), axis=-1)
