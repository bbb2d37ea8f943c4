"""Division of a skeleton into parts: trunk, head, and upper arm, forearm, hand and finger bones of each arm."""

from typing import NamedTuple

import numpy as np

from ha2g_jax.skeleton import Skeleton, mirror_directions, normalize

SIDES = ("left", "right")
TRUNK, HEAD, UPPER_ARM, FOREARM, HAND, FINGER = "trunk", "head", "upper arm", "forearm", "hand", "finger"

# Angle between a resting forearm and straight down; speakers hold the forearms so between gestures.
_RESTING_FOREARM = np.deg2rad(65)


class Part(NamedTuple):
    """Bones that rotate together.

    Attributes:
        kind: `TRUNK`, `HEAD`, `UPPER_ARM`, `FOREARM`, `HAND` or `FINGER`.
        side: "left" or "right", "" on the midline.
        bones: indices of the bones; more than one for the head and for the bones that leave the wrist.
        parent: index of the bone that the part rotates with, -1 for a part that rotates with none.
    """

    kind: str
    side: str
    bones: tuple[int, ...]
    parent: int


def parts(skeleton: Skeleton) -> tuple[Part, ...]:
    """Divide all bones of a skeleton into parts, each after the part it is attached to.

    The upper arms are attached to no part: their direction follows gravity and the target of a gesture, not the
    inclination of the trunk.

    Args:
        skeleton: skeleton to divide.
    """
    arms = [part for side in SIDES for part in _arm(skeleton, side)]
    shoulders = [skeleton.paths[skeleton.joint(f"{side}_shoulder")] for side in SIDES]
    trunk = np.flatnonzero(np.sum(shoulders, axis=0)).tolist()
    rest = set(range(skeleton.num_bones)) - set(trunk) - {bone for part in arms for bone in part.bones}
    head = [Part(HEAD, "", tuple(sorted(rest)), -1)] if rest else []
    return (*(Part(TRUNK, "", (bone,), -1) for bone in trunk), *head, *arms)


def arm_parts(skeleton: Skeleton, *sides: str) -> tuple[Part, ...]:
    """Return the parts of the arms: upper arm, forearm, hand and fingers.

    Args:
        skeleton: skeleton to divide.
        *sides: "left" or "right"; both by default.
    """
    return tuple(part for part in parts(skeleton) if part.side in (sides or SIDES))


def bones_of(chosen: tuple[Part, ...]) -> list[int]:
    """Return the indices of all bones of the given parts."""
    return [bone for part in chosen for bone in part.bones]


def _arm(skeleton: Skeleton, side: str) -> list[Part]:
    upper, fore = (skeleton.bone(f"{side}_{joint}") for joint in ("elbow", "wrist"))
    wrist = skeleton.joint(f"{side}_wrist")
    hand = tuple(bone for bone, (start, _) in enumerate(skeleton.bones) if start == wrist)
    ending = {child: bone for bone, (_, child) in enumerate(skeleton.bones)}
    fingers = [
        bone
        for bone, (_, child) in enumerate(skeleton.bones)
        if skeleton.paths[child, fore] and bone not in (fore, *hand)
    ]
    depth = skeleton.paths.sum(axis=1)
    fingers.sort(key=lambda bone: depth[skeleton.bones[bone][1]])
    return [
        Part(UPPER_ARM, side, (upper,), -1),
        Part(FOREARM, side, (fore,), upper),
        *([Part(HAND, side, hand, fore)] if hand else []),
        *(Part(FINGER, side, (bone,), ending[skeleton.bones[bone][0]]) for bone in fingers),
    ]


def rest_pose(skeleton: Skeleton) -> np.ndarray:
    """Return the rest pose of a skeleton, (bones, 3) float32 unit vectors.

    It is the mean pose of the skeleton's data, made symmetric, with forearms and hands lowered until the forearms are
    at 65 degrees from straight down.

    Args:
        skeleton: skeleton of the pose.
    """
    mean = skeleton.mean_directions.astype(np.float64)
    pose = normalize(mean + mirror_directions(skeleton, mean))
    for side in SIDES:
        arm = bones_of(tuple(part for part in arm_parts(skeleton, side) if part.kind != UPPER_ARM))
        pose[arm] = _lowered(pose[arm], pose[skeleton.bone(f"{side}_wrist")])
    return pose.astype(np.float32)


def _lowered(vectors: np.ndarray, forearm: np.ndarray) -> np.ndarray:
    """Return vectors (n, 3) after the rotation that lowers the forearm (3,)."""
    down = np.array([0.0, 1.0, 0.0])
    axis = np.cross(forearm, down)
    sine = np.linalg.norm(axis)
    angle = max(np.arctan2(sine, forearm @ down) - _RESTING_FOREARM, 0)
    axis /= max(sine, 1e-9)
    along = np.outer(vectors @ axis, axis)
    return along + np.cos(angle) * (vectors - along) + np.sin(angle) * np.cross(axis, vectors)
