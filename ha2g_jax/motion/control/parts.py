"""Division of a skeleton into parts, from the trunk to the finger bones, and the rotations of parts from a pose.

The rotation of each part is relative to the part it is attached to: that of the forearm to the upper arm, that of the
hand to the forearm. So a pose with scaled rotations still has a hand of the right shape on its arm; if the direction of
each bone were scaled on its own, the hand would come apart.
"""

from typing import NamedTuple

import numpy as np

from ha2g_jax.motion.rotations import IDENTITY, between, conjugate, fit, multiply, rotate
from ha2g_jax.skeleton import Skeleton, mirror_directions, normalize

SIDES = ("left", "right")
TRUNK, HEAD, UPPER_ARM, FOREARM, HAND, FINGER = "trunk", "head", "upper arm", "forearm", "hand", "finger"

# Angle between a resting forearm and straight down; speakers hold the forearms so between gestures.
_RESTING_FOREARM = np.deg2rad(65)
# The rotation of a head or a hand is continued in its direction up to this angle; beyond it the short way is taken.
_LONGEST = 1.3 * np.pi

# Indices of the bones that rotate together -> (T, 4) unit quaternions.
Rotations = dict[tuple[int, ...], np.ndarray]


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
    """
    arms = [part for side in SIDES for part in _arm(skeleton, side)]
    shoulders = [skeleton.paths[skeleton.joint(f"{side}_shoulder")] for side in SIDES]
    trunk = np.flatnonzero(np.sum(shoulders, axis=0)).tolist()
    rest = set(range(skeleton.num_bones)) - set(trunk) - {bone for part in arms for bone in part.bones}
    head = [Part(HEAD, "", tuple(sorted(rest)), -1)] if rest else []
    return (*(Part(TRUNK, "", (bone,), -1) for bone in trunk), *head, *arms)


def arm_parts(skeleton: Skeleton, *sides: str) -> tuple[Part, ...]:
    """Return the parts of the arms, by default of both: upper arm, forearm, hand and fingers."""
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


def rotations_from(reference: np.ndarray, directions: np.ndarray, chosen: tuple[Part, ...]) -> Rotations:
    """Compute the rotations of parts from a reference pose (bones, 3) to the poses of a motion (T, bones, 3).

    The parts include those that they are attached to.

    Returns:
        Unit quaternions (T, 4) of each bone, and of all bones of a head or a hand together, by the indices of the
        bones. The latter are continuous over time and so may have w < 0, which stands for an angle above pi.
    """
    reference, poses = np.asarray(reference, np.float64), np.asarray(directions, np.float64)
    frames: dict[int, np.ndarray] = {-1: IDENTITY}
    rotations = {}
    for part in chosen:
        frame, bones = frames[part.parent], list(part.bones)
        if part.kind in (HEAD, HAND):
            common, _ = fit(rotate(conjugate(frame)[..., None, :], poses[:, bones]), reference[bones])
            rotations[part.bones] = _continuous(common)
            frame = multiply(frame, rotations[part.bones])
        for bone in bones:
            rotations[bone,] = between(reference[bone], rotate(conjugate(frame), poses[:, bone]))
            frames[bone] = multiply(frame, rotations[bone,])
    return rotations


def apply_rotations(reference: np.ndarray, rotations: Rotations, chosen: tuple[Part, ...]) -> dict[int, np.ndarray]:
    """Rotate the parts of a reference pose (bones, 3), the inverse of `rotations_from`.

    Returns:
        (T, 3) direction vectors by the index of the bone.
    """
    reference = np.asarray(reference, np.float64)
    frames: dict[int, np.ndarray] = {-1: IDENTITY}
    directions = {}
    for part in chosen:
        frame = frames[part.parent]
        if part.kind in (HEAD, HAND):
            frame = multiply(frame, rotations[part.bones])
        for bone in part.bones:
            frames[bone] = multiply(frame, rotations[bone,])
            directions[bone] = rotate(frames[bone], reference[bone])
    return directions


def power(rotation: np.ndarray, exponent: np.ndarray) -> np.ndarray:
    """Scale the angles of unit quaternions (T, 4) by factors (T,); one with w < 0 stands for the angle above pi."""
    axis = rotation[:, :3]
    length = np.linalg.norm(axis, axis=-1, keepdims=True)
    half = exponent[:, None] * np.arctan2(length, rotation[:, 3:])
    return np.concatenate([axis / np.maximum(length, 1e-12) * np.sin(half), np.cos(half)], axis=-1)


def _continuous(rotations: np.ndarray) -> np.ndarray:
    """Return the same rotations (T, 4) with signs that are continuous over time up to the longest angle."""
    stays = (np.sum(rotations[1:] * rotations[:-1], axis=-1) >= 0).tolist()
    least = np.cos(_LONGEST / 2)
    signs = [1.0]
    for stay, w in zip(stays, rotations[1:, 3].tolist(), strict=True):
        sign = signs[-1] if stay else -signs[-1]
        signs.append(sign if sign * w >= least else -sign)
    return rotations * np.array(signs)[:, None]
