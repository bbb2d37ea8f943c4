"""Face joints for bodies without a face: points fixed on the head, which show its rotation."""

import numpy as np
from scipy.spatial.transform import Rotation

from ha2g_jax.motion.readers.axes import headings
from ha2g_jax.skeleton import Skeleton

FACE = ("nose", "head", "right_eye", "left_eye", "right_ear", "left_ear")


def face_joints(skeleton: Skeleton) -> tuple[int, ...]:
    """Return the indices of the skeleton's joints that lie on the head."""
    return tuple(index for index, joint in enumerate(skeleton.joints) if joint in FACE)


def add_face(
    positions: np.ndarray, head_positions: np.ndarray, head_rotations: np.ndarray, skeleton: Skeleton, *, up: str = "y"
) -> np.ndarray:
    """Set the joints of the face of a motion.

    Rest poses are not reliable, because many files store every bone along its own axis. Therefore the head is assumed
    to look ahead on average. M, the mean over the frames of heading^-1 head, is the rotation of an upright head that
    faces where the shoulders face, and head M^-1 is the rotation of the face in each frame. The points are placed so
    that their mean offset from the middle of the shoulders is that of the mean pose, because formats put the neck, but
    not the shoulders, at different heights.

    Args:
        positions: (T, joints, 3) metres, right-handed, with both shoulders; the joints of the face are ignored.
        head_positions: (T, 3) metres, position of the joint that the head rotates about.
        head_rotations: (T, 3, 3) rotation of the head in the same coordinates, from any rest pose.
        skeleton: skeleton of the joints, whose mean pose gives the face.
        up: axis of the coordinates that points up, one of `axes.UPS`.

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
