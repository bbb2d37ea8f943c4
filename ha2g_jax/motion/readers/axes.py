"""Conversion of motion capture to the axes of a skeleton: metres, y down, facing as the skeleton's mean pose.

The coordinate system of the file must be right-handed, as those of BVH and SMPL-X are: then left x up = ahead.
"""

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.skeleton import Skeleton

UPS = ("y", "-y", "z", "-z", "x", "-x")

_UP_VECTORS = {
    **{"y": (0.0, 1.0, 0.0), "-y": (0.0, -1.0, 0.0), "z": (0.0, 0.0, 1.0), "-z": (0.0, 0.0, -1.0)},
    **{"x": (1.0, 0.0, 0.0), "-x": (-1.0, 0.0, 0.0)},
}
# Minimum horizontal fraction of the shoulders' width, in a frame and on average, that determines where a person faces.
_MIN_LEVEL, _MIN_MEAN_LEVEL = 0.2, 0.1


def to_skeleton_axes(positions: np.ndarray, skeleton: Skeleton, *, up: str = "y") -> np.ndarray:
    """Rotate and translate a recording as one rigid body into the axes of a skeleton.

    The rotation maps the up axis and the mean heading onto those of the skeleton (TED-Expressive: left +x, ahead -z;
    TED-Gesture: left -x, ahead +z), so the vertical stays vertical. The translation maps the mean position of the
    spine onto that of the mean pose.

    Args:
        positions: (T, joints, 3) metres, right-handed.
        skeleton: skeleton of the joints and the axes.
        up: axis of the file that points up, one of `UPS`.

    Returns:
        (T, joints, 3) metres in float64.

    Raises:
        UserError: the shoulders lie along the up axis, so that there is no heading.
    """
    heading = mean_heading(positions, skeleton, up=up)
    rotated = np.asarray(positions, np.float64) @ heading
    return rotated + (skeleton.mean_pose[0] - rotated[:, 0].mean(axis=0))


def mean_heading(positions: np.ndarray, skeleton: Skeleton, *, up: str = "y") -> np.ndarray:
    """Find the axes of the skeleton in the coordinates of the file, for the whole recording.

    Args:
        positions: (T, joints, 3) in any unit.
        skeleton: skeleton of the joints and the axes.
        up: axis of the file that points up, one of `UPS`.

    Returns:
        (3, 3) rotation matrix whose columns are x, y and z of the skeleton.

    Raises:
        UserError: the shoulders lie along the up axis.
    """
    left, level = _left(positions, skeleton, up)
    if level.max(initial=0) < _MIN_LEVEL:
        raise UserError(
            f"the person's shoulders lie along the {up} axis, which was taken to point up; name another axis as up"
        )
    mean = left.mean(axis=0)
    if np.linalg.norm(mean) < _MIN_MEAN_LEVEL:  # a person who faces all directions: the first heading counts
        mean = left[np.argmax(level >= _MIN_LEVEL)]
    return _frame(mean[None], skeleton, up)[0]


def headings(positions: np.ndarray, skeleton: Skeleton, *, up: str = "y") -> tuple[np.ndarray, np.ndarray]:
    """Find the axes of the skeleton in the coordinates of the file, frame by frame.

    The axes follow the heading of the shoulders, and y is always vertical.

    Args:
        positions: (T, joints, 3) in any unit.
        skeleton: skeleton of the joints and the axes.
        up: axis of the file that points up, one of `UPS`.

    Returns:
        (T, 3, 3) rotation matrices whose columns are x, y and z of the skeleton, and (T,) reliability of each, from 0
        (the shoulders are vertical) to 1 (they are level).
    """
    left, level = _left(positions, skeleton, up)
    is_level = level >= _MIN_LEVEL
    left[~is_level] = _any_level(up)
    return _frame(left, skeleton, up), np.where(is_level, level, 0.0)


def find_up(positions: np.ndarray, skeleton: Skeleton) -> str:
    """Find the axis that points up: the one nearest to the mean direction from spine to neck.

    Args:
        positions: (T, joints, 3) in any unit.
        skeleton: skeleton of the joints.

    Returns:
        One of `UPS`.
    """
    trunk = positions[:, skeleton.joint("neck")] - positions[:, skeleton.joint("spine")]
    mean = trunk.mean(axis=0)
    return max(UPS, key=lambda up: float(mean @ np.array(_UP_VECTORS[up])))


def _left(positions: np.ndarray, skeleton: Skeleton, up: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the horizontal part of each frame's unit vector to the person's left, (T, 3), and its length (T,)."""
    shoulders = positions[:, skeleton.joint("left_shoulder")] - positions[:, skeleton.joint("right_shoulder")]
    shoulders = np.asarray(shoulders, np.float64)
    vertical = np.array(_UP_VECTORS[up])
    left = shoulders / np.maximum(np.linalg.norm(shoulders, axis=-1, keepdims=True), 1e-12)
    left = left - (left @ vertical)[:, None] * vertical
    return left, np.linalg.norm(left, axis=-1)


def _frame(left: np.ndarray, skeleton: Skeleton, up: str) -> np.ndarray:
    """Return (T, 3, 3) with the skeleton's axes as columns, from horizontal vectors (T, 3) to the person's left."""
    left = left / np.linalg.norm(left, axis=-1, keepdims=True)
    pose = skeleton.mean_pose
    sign = np.sign(pose[skeleton.joint("left_shoulder"), 0] - pose[skeleton.joint("right_shoulder"), 0])
    x = sign * left
    y = np.broadcast_to(-np.array(_UP_VECTORS[up]), x.shape)
    return np.stack([x, y, np.cross(x, y)], axis=-1)


def _any_level(up: str) -> np.ndarray:
    return np.roll(np.array(_UP_VECTORS[up]), 1)
