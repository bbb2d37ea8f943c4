"""Armatures (trees of joints with a rest pose), their animations, and the armature of a skeleton.

Axes in this module: metres, y up, the person faces +z, the person's left is at +x.
"""

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any

import numpy as np

from ha2g_jax.motion import lower_body, rotations
from ha2g_jax.motion.lower_body import LowerBody
from ha2g_jax.skeleton import FINGERS, Skeleton, load_skeleton, mirror_directions, normalize

UP, LEFT = np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0])
FOUR_FINGERS = FINGERS[1:]

# Joints that rotate one of several bones, by the joint at the end of the bone; the names of others end in 0, as in
# left_index_0.
_CARRIERS = {"left_shoulder": "left_clavicle", "right_shoulder": "right_clavicle", "nose": "head"}


@dataclasses.dataclass(frozen=True)
class Armature:
    """A tree of joints, each with an origin and axes of its own.

    Attributes:
        name: name of the rig, such as "ha2g".
        joints: names, each after its parent; joint 0 is the root.
        parents: index of each joint's parent, -1 for the root.
        offsets: (J, 3) metres from the parent's origin, in the parent's axes at rest.
        rest: (J, 4) rotation of each joint relative to its parent in the rest pose.
    """

    name: str
    joints: tuple[str, ...]
    parents: tuple[int, ...]
    offsets: np.ndarray
    rest: np.ndarray

    def __repr__(self) -> str:
        return f"Armature({self.name!r}, {len(self.joints)} joints)"

    def joint(self, name: str) -> int:
        return self.joints.index(name)


@dataclasses.dataclass(frozen=True)
class Animation:
    """Rotations (T, J, 4) of joints relative to their parents, and positions (T, 3) of the root in metres."""

    armature: Armature
    rotations: np.ndarray
    translation: np.ndarray
    fps: float
    meta: dict[str, Any]

    def __repr__(self) -> str:
        return f"Animation({self.armature.name!r}, {self.num_frames} frames, {self.fps:g} fps)"

    @property
    def num_frames(self) -> int:
        return len(self.rotations)


def world(animation: Animation) -> tuple[np.ndarray, np.ndarray]:
    """Compute the forward kinematics of an animation: (T, J, 4) rotations and (T, J, 3) metres in the world."""
    armature, local = animation.armature, animation.rotations
    rotated = np.empty(local.shape)
    positions = np.empty((*local.shape[:2], 3))
    rotated[:, 0], positions[:, 0] = local[:, 0], animation.translation
    for joints, parents in generations(armature.parents)[1:]:
        above = rotated[:, parents]
        rotated[:, joints] = rotations.multiply(above, local[:, joints])
        positions[:, joints] = positions[:, parents] + rotations.rotate(above, armature.offsets[joints])
    return rotated, positions


def relative(turned: np.ndarray, parents: Sequence[int]) -> np.ndarray:
    """Return rotations (..., J, 4) relative to the parents of those in the world; joint 0 is the root, and stays."""
    local = turned.copy()
    local[..., 1:, :] = rotations.multiply(rotations.conjugate(turned[..., parents[1:], :]), turned[..., 1:, :])
    return local


def rest_positions(armature: Armature) -> tuple[np.ndarray, np.ndarray]:
    """Return (J, 4) orientations and (J, 3) positions in metres of an armature at rest, its root at the origin."""
    still = Animation(armature, armature.rest[None], np.zeros((1, 3)), 1.0, {})
    orientations, positions = world(still)
    return orientations[0], positions[0]


@functools.lru_cache(maxsize=16)
def generations(parents: tuple[int, ...]) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    """Group the joints of a tree by the number of joints above them: their indices and those of their parents."""
    depths: list[int] = []
    for parent in parents:
        depths.append(depths[parent] + 1 if parent >= 0 else 0)
    groups = [np.flatnonzero(np.array(depths) == depth) for depth in range(max(depths) + 1)]
    return tuple((joints, np.array(parents)[joints]) for joints in groups)


def export_axes(skeleton: Skeleton) -> np.ndarray:
    """Return (3,) signs that convert vectors from the skeleton's axes to those of this module, and back: y down becomes
    y up, and the person faces +z with the left at +x.
    """
    return np.array([skeleton.left, -1.0, -skeleton.left])


def ha2g_armature(skeleton: Skeleton) -> Armature:
    """Build the armature "ha2g" of a skeleton in a T-pose: palms down, fingers along the arm, head up.

    At rest all rotations are zero. All joints of the skeleton are joints of the armature, at the same positions. Where
    several bones leave one joint, each bone has a further joint there, with offset 0, that rotates it: left_clavicle;
    head, from the neck to the nose (nose_0 in TED-Gesture, where head is the top of the head); left_eye_0; left_index_0
    and so on, and the same on the right. A joint at the end of a chain never rotates.
    """
    directions = rest_directions(skeleton)
    joints, parents, offsets = [skeleton.joints[0]], [-1], [np.zeros(3)]

    def add(name: str, parent: int, offset: np.ndarray) -> int:
        joints.append(name)
        parents.append(parent)
        offsets.append(offset)
        return len(joints) - 1

    def grow(start: int, index: int) -> None:
        bones = [bone for bone, (parent, _) in enumerate(skeleton.bones) if parent == start]
        for bone in bones:
            child = skeleton.bones[bone][1]
            name = skeleton.joints[child]
            carrier = add(_carrier(skeleton, name), index, np.zeros(3)) if len(bones) > 1 else index
            grow(child, add(name, carrier, float(skeleton.lengths[bone]) * directions[bone]))

    grow(0, 0)
    rest = np.tile(rotations.IDENTITY, (len(joints), 1))
    return Armature("ha2g", tuple(joints), tuple(parents), np.array(offsets), rest)


def figure_armature(skeleton: Skeleton) -> Armature:
    """Return the armature of a motion: the rest pose of the package's skeleton, with the bone lengths of its own."""
    return ha2g_armature(dataclasses.replace(load_skeleton(skeleton.name), lengths=skeleton.lengths))


def add_lower_body(animation: Animation, lower: LowerBody) -> Animation:
    """Put an animation of the `ha2g` armature on a pelvis with legs, whose joints come before its own.

    The pelvis becomes the root, and the joint `spine` its child at a constant offset, so that the position of the chest
    is exact only on average. Rotations in the world stay those of the animation.
    """
    turned = rotations.unit(lower.rotations)
    local = relative(turned, lower_body.PARENTS)
    upper = animation.rotations.copy()
    upper[:, 0] = rotations.multiply(rotations.conjugate(turned[:, 0]), upper[:, 0])
    whole = rotations.continuous(rotations.unit(np.concatenate([local, upper], axis=1)))
    extended = with_legs(animation.armature, lower.offsets)
    return Animation(extended, whole, lower.translation.astype(np.float64), animation.fps, animation.meta)


def with_legs(armature: Armature, offsets: np.ndarray) -> Armature:
    """Put the `ha2g` armature on a pelvis with legs, whose `offsets` (10, 3) are those of a `LowerBody`."""
    legs = lower_body.JOINTS
    parents = (*lower_body.PARENTS, 0, *(parent + len(legs) for parent in armature.parents[1:]))
    offsets = np.concatenate([offsets, armature.offsets[1:]]).astype(np.float64)
    rest = np.concatenate([np.tile(rotations.IDENTITY, (len(legs), 1)), armature.rest])
    return Armature(armature.name, (*legs, *armature.joints), parents, offsets, rest)


def carriers(skeleton: Skeleton) -> tuple[str, ...]:
    """Return the name of the joint of `ha2g_armature` that rotates each bone of a skeleton."""
    starts = [parent for parent, _ in skeleton.bones]
    return tuple(
        _carrier(skeleton, skeleton.joints[child]) if starts.count(parent) > 1 else skeleton.joints[parent]
        for parent, child in skeleton.bones
    )


def _carrier(skeleton: Skeleton, child: str) -> str:
    """Return the name of the joint that rotates the bone to `child`, one of several bones of a joint."""
    name = _CARRIERS.get(child)
    if name is not None and name not in skeleton.joints:
        return name
    return f"{child.removesuffix('_1')}_0"


def rest_directions(skeleton: Skeleton) -> np.ndarray:
    """Return (bones, 3) unit vectors of the bones in the T-pose.

    Trunk, arms and fingers are straight. Collarbones and face are those of the mean pose of the data, made symmetric,
    and so are the bones within the hand, rotated so that the bone of the middle finger lies along the arm and the palm
    is level.
    """
    mean = skeleton.mean_directions.astype(np.float64)
    mean = normalize(mean + mirror_directions(skeleton, mean)) * export_axes(skeleton)
    hand = _rest_hand(skeleton, mean) if "left_index_1" in skeleton.joints else {}
    rest = mean.copy()
    for bone, (_, child) in enumerate(skeleton.bones):
        name = skeleton.joints[child]
        part = name.removeprefix("left_").removeprefix("right_")
        side = np.array([-1.0, 1.0, 1.0]) if name.startswith("right_") else np.ones(3)
        if name == "neck":
            rest[bone] = UP
        elif part in ("elbow", "wrist"):
            rest[bone] = LEFT * side
        elif part in hand:
            rest[bone] = hand[part] * side
    return rest


def _rest_hand(skeleton: Skeleton, mean: np.ndarray) -> dict[str, np.ndarray]:
    """Return unit vectors of the bones of a left hand along +x, palm down, by the end joint without its side."""
    fan = {finger: mean[skeleton.bone(f"left_{finger}_1")] for finger in (*FOUR_FINGERS, "thumb")}
    along = fan["middle"]
    back = rotations.unit(np.cross(fan["index"] - fan["pinky"], along))
    axes = np.stack([along, back, np.cross(along, back)])
    directions = {f"{finger}_1": rotations.unit(axes @ vector) for finger, vector in fan.items()}
    for part in (2, 3):
        directions |= {f"{finger}_{part}": LEFT for finger in FOUR_FINGERS}
        directions[f"thumb_{part}"] = directions["thumb_1"]
    return directions
