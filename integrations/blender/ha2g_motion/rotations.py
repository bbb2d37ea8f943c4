"""Rotations as unit quaternions in the order x, y, z, w, numpy (..., 4); `multiply(a, b)` rotates by b first."""

import numpy as np

IDENTITY = np.array([0.0, 0.0, 0.0, 1.0])


def multiply(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the rotation b (..., 4) followed by the rotation a (..., 4)."""
    u, v = a[..., :3], b[..., :3]
    vector = a[..., 3:] * v + b[..., 3:] * u + np.cross(u, v)
    return np.concatenate([vector, a[..., 3:] * b[..., 3:] - np.sum(u * v, axis=-1, keepdims=True)], axis=-1)


def conjugate(q: np.ndarray) -> np.ndarray:
    """Return the inverse rotations (..., 4) of unit quaternions (..., 4)."""
    return q * np.array([-1.0, -1.0, -1.0, 1.0])


def rotate(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return vectors v (..., 3) rotated by unit quaternions q (..., 4)."""
    twice = 2 * np.cross(q[..., :3], v)
    return v + q[..., 3:] * twice + np.cross(q[..., :3], twice)


def unit(vectors: np.ndarray) -> np.ndarray:
    """Return vectors (..., n) scaled to length 1; a zero vector stays zero."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)


def about(axis: np.ndarray, degrees: np.ndarray) -> np.ndarray:
    """Return rotations (..., 4) about one unit axis (3,) by angles (...) in degrees."""
    half = np.radians(degrees)[..., None] / 2
    return np.concatenate([np.sin(half) * axis, np.cos(half)], axis=-1)


def between(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return the shortest rotation (4,) from u (3,) to v (3,); if they are opposite, about a fixed axis."""
    u, v = unit(u), unit(v)
    middle = u + v
    if np.linalg.norm(middle) < 1e-7:
        middle = np.cross(u, np.eye(3)[np.argmin(np.abs(u))])
    middle = unit(middle)
    return unit(np.append(np.cross(u, middle), u @ middle))


def from_matrix(matrix: np.ndarray) -> np.ndarray:
    """Return the quaternion (4,) of a rotation matrix (3, 3)."""
    # The quaternion is the eigenvector of the greatest eigenvalue of this symmetric matrix (Bar-Itzhack 2000).
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = matrix
    symmetric = np.array(
        [
            [xx - yy - zz, yx + xy, zx + xz, zy - yz],
            [yx + xy, yy - xx - zz, zy + yz, xz - zx],
            [zx + xz, zy + yz, zz - xx - yy, yx - xy],
            [zy - yz, xz - zx, yx - xy, xx + yy + zz],
        ]
    )
    q = np.linalg.eigh(symmetric)[1][:, -1]
    return q if q[3] >= 0 else -q


def slerp(a: np.ndarray, b: np.ndarray, weight: float) -> np.ndarray:
    """Interpolate between rotations a (..., 4), at weight 0, and b (..., 4), at weight 1, along the shorter arc."""
    cosine = np.sum(a * b, axis=-1, keepdims=True)
    b, cosine = np.where(cosine < 0, -b, b), np.minimum(np.abs(cosine), 1.0)
    angle = np.arccos(cosine)
    sine = np.where(angle > 1e-6, np.sin(angle), 1.0)
    first = np.where(angle > 1e-6, np.sin((1 - weight) * angle) / sine, 1 - weight)
    second = np.where(angle > 1e-6, np.sin(weight * angle) / sine, weight)
    return unit(first * a + second * b)


def continuous(q: np.ndarray) -> np.ndarray:
    """Return the same rotations (T, ..., 4) with signs that are continuous over time and w >= 0 in the first frame."""
    flips = np.concatenate([q[:1, ..., 3] < 0, np.sum(q[1:] * q[:-1], axis=-1) < 0])
    return np.where((np.cumsum(flips, axis=0) % 2 == 1)[..., None], -q, q)
