"""Turns the world of a motion capture into the axes of a skeleton: metres, y down, facing as its mean pose does.

The source's world must be right-handed, as that of BVH and SMPL-X is: then the person's left and the way up tell the
way ahead, left x up = ahead.
"""

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.skeleton import Skeleton

UPS = ("y", "-y", "z", "-z")

_UP_VECTORS = {"y": (0.0, 1.0, 0.0), "-y": (0.0, -1.0, 0.0), "z": (0.0, 0.0, 1.0), "-z": (0.0, 0.0, -1.0)}
# Shares of the shoulders' width that must be horizontal, in a frame and on average, for a facing to be told.
_MIN_LEVEL, _MIN_MEAN_LEVEL = 0.2, 0.1


def to_skeleton_axes(positions: np.ndarray, skeleton: Skeleton, *, up: str = "y") -> np.ndarray:
    """The recording, turned and moved as one rigid body.

    Upright stays upright: only the way up and the mean facing are turned onto the skeleton's (TED-Expressive: left +x,
    ahead -z; TED-Gesture: left -x, ahead +z), and the mean position of the spine is moved onto the mean pose's.

    Args:
        positions: (T, joints, 3) metres, right-handed.
        skeleton: names the joints and gives the axes.
        up: the source's axis that points up, one of `UPS`.

    Returns:
        (T, joints, 3) metres in float64.

    Raises:
        UserError: the shoulders lie along the axis that should point up, so that the person faces nowhere.
    """
    heading = mean_heading(positions, skeleton, up=up)
    turned = np.asarray(positions, np.float64) @ heading
    return turned + (skeleton.mean_pose[0] - turned[:, 0].mean(axis=0))


def mean_heading(positions: np.ndarray, skeleton: Skeleton, *, up: str = "y") -> np.ndarray:
    """The skeleton's axes in the source's world: one (3, 3) for the recording, its columns x, y and z of the skeleton.

    Args:
        positions: (T, joints, 3), of any unit.
        skeleton: names the joints and gives the axes.
        up: the source's axis that points up, one of `UPS`.

    Raises:
        UserError: the shoulders lie along the axis that should point up.
    """
    left, level = _left(positions, skeleton, up)
    if level.max(initial=0) < _MIN_LEVEL:
        raise UserError(
            f"the person's shoulders lie along the {up} axis, which was taken to point up; name another axis as up"
        )
    mean = left.mean(axis=0)
    if np.linalg.norm(mean) < _MIN_MEAN_LEVEL:  # somebody who turns round and round faces as at first
        mean = left[np.argmax(level >= _MIN_LEVEL)]
    return _frame(mean[None], skeleton, up)[0]


def headings(positions: np.ndarray, skeleton: Skeleton, *, up: str = "y") -> tuple[np.ndarray, np.ndarray]:
    """The skeleton's axes in the source's world frame by frame, turned with the shoulders but always upright.

    Args:
        positions: (T, joints, 3), of any unit.
        skeleton: names the joints and gives the axes.
        up: the source's axis that points up, one of `UPS`.

    Returns:
        (T, 3, 3) rotation matrices, their columns x, y and z of the skeleton, and (T,) how far each can be relied on,
        from 0 (the shoulders are vertical) to 1 (they are level).
    """
    left, level = _left(positions, skeleton, up)
    is_level = level >= _MIN_LEVEL
    left[~is_level] = _any_level(up)
    return _frame(left, skeleton, up), np.where(is_level, level, 0.0)


def find_up(positions: np.ndarray, skeleton: Skeleton) -> str:
    """The axis that points up, one of `UPS`: nearest to the mean direction from spine to neck, (T, joints, 3)."""
    trunk = positions[:, skeleton.joint("neck")] - positions[:, skeleton.joint("spine")]
    mean = trunk.mean(axis=0)
    return max(UPS, key=lambda up: float(mean @ np.array(_UP_VECTORS[up])))


def _left(positions: np.ndarray, skeleton: Skeleton, up: str) -> tuple[np.ndarray, np.ndarray]:
    """The horizontal part of each frame's unit vector to the person's left, (T, 3), and its length (T,)."""
    shoulders = positions[:, skeleton.joint("left_shoulder")] - positions[:, skeleton.joint("right_shoulder")]
    shoulders = np.asarray(shoulders, np.float64)
    vertical = np.array(_UP_VECTORS[up])
    left = shoulders / np.maximum(np.linalg.norm(shoulders, axis=-1, keepdims=True), 1e-12)
    left = left - (left @ vertical)[:, None] * vertical
    return left, np.linalg.norm(left, axis=-1)


def _frame(left: np.ndarray, skeleton: Skeleton, up: str) -> np.ndarray:
    """(T, 3, 3) with the skeleton's axes as columns, from horizontal vectors (T, 3) to the person's left."""
    left = left / np.linalg.norm(left, axis=-1, keepdims=True)
    pose = skeleton.mean_pose
    sign = np.sign(pose[skeleton.joint("left_shoulder"), 0] - pose[skeleton.joint("right_shoulder"), 0])
    x = sign * left
    y = np.broadcast_to(-np.array(_UP_VECTORS[up]), x.shape)
    return np.stack([x, y, np.cross(x, y)], axis=-1)


def _any_level(up: str) -> np.ndarray:
    return np.roll(np.array(_UP_VECTORS[up]), 1)
