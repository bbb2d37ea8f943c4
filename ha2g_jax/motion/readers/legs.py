"""Pelvis and legs of motion capture, whatever the rest pose of the file."""

import numpy as np
from scipy.spatial.transform import Rotation

from ha2g_jax.motion.lower_body import JOINTS, PARENTS, LowerBody
from ha2g_jax.skeleton import Skeleton

# Direction of the foot in the T-pose, from the ankle to its ball; a file without toes has feet of this length.
_FOOT = np.array([0.0, -0.36, 0.93])
_FOOT_LENGTH = 0.14
_DOWN, _LEFT = np.array([0.0, -1.0, 0.0]), np.array([1.0, 0.0, 0.0])


def to_export_axes(heading: np.ndarray, skeleton: Skeleton) -> np.ndarray:
    """Return the (3, 3) rotation from the axes of a file to y up, facing +z: `positions @ rotation`.

    Args:
        heading: (3, 3) rotation to the axes of the skeleton, see `axes.mean_heading`.
        skeleton: skeleton of these axes.
    """
    left, right = (skeleton.mean_pose[skeleton.joint(f"{side}_shoulder"), 0] for side in ("left", "right"))
    return heading * (np.array([1.0, -1.0, -1.0]) if left > right else np.array([-1.0, -1.0, 1.0]))


def from_captured(positions: np.ndarray, rotations: np.ndarray, spine: np.ndarray) -> LowerBody:
    """Find the rotations of pelvis and legs from the T-pose, and the bones of the T-pose.

    Rest poses are not reliable, because many files store every bone along its own axis. A joint rotates as in the file,
    and only the constant rotation from the T-pose is found: its bone is straight in the T-pose, and its left is on
    average that of the pelvis, whose left is the line of the hips and which is upright on average.

    Args:
        positions: (T, 9, 3) metres of `lower_body.JOINTS`, y up, facing +z; NaN for feet that the file lacks.
        rotations: (T, 9, 3, 3) rotations of the joints in these axes, from any rest pose.
        spine: (T, 3) metres of the joint `spine` of the skeleton.
    """
    names = {name: index for index, name in enumerate(JOINTS)}
    own = [Rotation.from_matrix(rotations[:, joint]) for joint in range(len(JOINTS))]
    hips = positions[:, names["left_hip"]] - positions[:, names["right_hip"]]
    found: dict[str, Rotation] = {}
    up = np.tile(-_DOWN, (len(hips), 1))
    found["pelvis"] = own[0] * _constant(own[0], hips, _LEFT, up, -_DOWN)
    offsets = np.zeros((len(JOINTS) + 1, 3))
    offsets[-1] = _mean_offset(found["pelvis"], spine - positions[:, 0])
    for side in ("left", "right"):
        hip, knee, ankle, foot = (names[f"{side}_{part}"] for part in ("hip", "knee", "ankle", "foot"))
        offsets[hip] = _mean_offset(found["pelvis"], positions[:, hip] - positions[:, 0])
        lateral = found["pelvis"].apply(_LEFT)
        for joint, end in ((hip, knee), (knee, ankle)):
            bone = positions[:, end] - positions[:, joint]
            found[JOINTS[joint]] = own[joint] * _constant(own[joint], bone, _DOWN, lateral, _LEFT)
            lateral = found[JOINTS[joint]].apply(_LEFT)
            offsets[end] = _DOWN * np.linalg.norm(bone, axis=-1).mean()
        shin, ankle_name, foot_name = found[f"{side}_knee"], JOINTS[ankle], JOINTS[foot]
        if np.isfinite(positions[:, foot]).all():
            bone = positions[:, foot] - positions[:, ankle]
            length = np.linalg.norm(bone, axis=-1).mean()
            found[ankle_name] = own[ankle] * _constant(own[ankle], bone, _FOOT, lateral, _LEFT)
            found[foot_name] = _like(own[foot], found[ankle_name])
        else:
            length = _FOOT_LENGTH
            found[ankle_name] = found[foot_name] = _like(own[ankle], shin)
        offsets[foot] = length * _FOOT / np.linalg.norm(_FOOT)
    quaternions = np.stack([found[name].as_quat() for name in JOINTS], axis=1)
    return LowerBody(offsets.astype(np.float32), quaternions.astype(np.float32), positions[:, 0].astype(np.float32))


def from_rest_pose(rest: np.ndarray, spine: np.ndarray, rotations: np.ndarray, pelvis: np.ndarray) -> LowerBody:
    """Return the lower body of a file whose rest pose is the T-pose, as that of SMPL-X is.

    Args:
        rest: (9, 3) metres of `lower_body.JOINTS` in the T-pose.
        spine: (3,) metres of the joint `spine` in the T-pose.
        rotations: (T, 9, 3, 3) rotations of the joints in the world, none in the T-pose.
        pelvis: (T, 3) metres of the pelvis.
    """
    offsets = np.array([*(rest[joint] - rest[max(parent, 0)] for joint, parent in enumerate(PARENTS)), spine - rest[0]])
    quaternions = np.stack([Rotation.from_matrix(rotations[:, i]).as_quat() for i in range(len(JOINTS))], axis=1)
    return LowerBody(offsets.astype(np.float32), quaternions.astype(np.float32), pelvis.astype(np.float32))


def _constant(
    own: Rotation, exact: np.ndarray, exact_rest: np.ndarray, about: np.ndarray, rest: np.ndarray
) -> Rotation:
    """Return the rotation from the T-pose to the axes of a joint.

    Args:
        own: T rotations of the joint.
        exact, exact_rest: (T, 3) vectors that are constant in the axes of the joint, and (3,) the same in the T-pose.
        about, rest: (T, 3) vectors that are so on average, and (3,) the same in the T-pose.
    """
    first = own.inv().apply(exact).mean(axis=0)
    second = own.inv().apply(about).mean(axis=0)
    return Rotation.from_matrix(_axes(first, second) @ _axes(exact_rest, rest).T)


def _axes(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return (3, 3) axes as columns: along the first vector, across it towards the second, and across both."""
    x = first / np.linalg.norm(first)
    y = second - (second @ x) * x
    y = y / max(float(np.linalg.norm(y)), 1e-12)
    return np.stack([x, y, np.cross(x, y)], axis=-1)


def _like(own: Rotation, other: Rotation) -> Rotation:
    """Return rotations of a joint that are on average those of another joint."""
    return own * (own.inv() * other).mean()


def _mean_offset(rotation: Rotation, bone: np.ndarray) -> np.ndarray:
    return rotation.inv().apply(bone).mean(axis=0)
