"""Gives a face to a body that has none: points fixed on the head, so that they show how the head turns."""

import numpy as np
from scipy.spatial.transform import Rotation

from ha2g_jax.data.mocap.axes import headings
from ha2g_jax.skeleton import Skeleton

FACE = ("nose", "head", "right_eye", "left_eye", "right_ear", "left_ear")


def face_joints(skeleton: Skeleton) -> tuple[int, ...]:
    """Indices of the skeleton's joints that lie on the head."""
    return tuple(index for index, joint in enumerate(skeleton.joints) if joint in FACE)


def add_face(
    positions: np.ndarray, head_positions: np.ndarray, head_rotations: np.ndarray, skeleton: Skeleton, *, up: str = "y"
) -> np.ndarray:
    """The motion with the joints of the face set.

    Rest poses cannot be relied on: many files store every bone along its own axis. So the head is taken to look ahead
    on average: M, the mean over the frames of heading^-1 head, is the rotation of a head that faces where the shoulders
    do, upright. Then heading = head M^-1 at such a moment, and head M^-1 turns as the head does. The points are placed
    so that on average they lie from the middle of the shoulders as in the mean pose: formats put the neck, but not the
    shoulders, at different heights.

    Args:
        positions: (T, joints, 3) metres, right-handed, with both shoulders; the face's joints are ignored.
        head_positions: (T, 3) metres, the joint that the head turns about.
        head_rotations: (T, 3, 3), the head's rotation in the same world, from whatever rest pose.
        skeleton: names the joints; its mean pose gives the face.
        up: the world's axis that points up, one of `axes.UPS`.

    Returns:
        (T, joints, 3) metres, a copy.
    """
    heading, reliance = headings(positions, skeleton, up=up)
    body, head = Rotation.from_matrix(heading), Rotation.from_matrix(head_rotations)
    weights = reliance if reliance.any() else None
    ahead = (body.inv() * head).mean(weights)
    facing = head * ahead.inv()
    shoulders = [skeleton.joint("left_shoulder"), skeleton.joint("right_shoulder")]
    to_head = body.inv().apply(head_positions - positions[:, shoulders].mean(axis=1))
    mean_to_head = np.average(to_head, axis=0, weights=weights)
    places = skeleton.mean_pose - skeleton.mean_pose[shoulders].mean(axis=0) - mean_to_head
    completed = np.array(positions, np.float64)
    for joint in face_joints(skeleton):
        completed[:, joint] = head_positions + facing.apply(places[joint])
    return completed
