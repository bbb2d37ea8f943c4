"""A tree of joints in its rest pose, its animation, and the armature that is made from a skeleton.

Axes of everything here: metres, y up, the person faces +z, the person's left is +x.
"""

import dataclasses
from typing import Any

import numpy as np

from ha2g_jax.motion import rotations
from ha2g_jax.skeleton import Skeleton, mirror_directions, normalize

UP, LEFT = np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0])
FOUR_FINGERS = ("index", "middle", "ring", "pinky")

# Joints that turn one of several bones, by the joint at its end; others are named after that, left_index_0.
_CARRIERS = {"left_shoulder": "left_clavicle", "right_shoulder": "right_clavicle", "nose": "head"}


@dataclasses.dataclass(frozen=True)
class Armature:
    """A tree of joints, each with an origin and axes of its own.

    Attributes:
        name: of the rig, such as "ha2g".
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

    def joint(self, name: str) -> int:
        return self.joints.index(name)


@dataclasses.dataclass(frozen=True)
class Animation:
    """An armature that moves.

    Attributes:
        armature: what moves.
        rotations: (T, J, 4) of each joint relative to its parent, the rest rotation included: at rest `armature.rest`.
        translation: (T, 3) metres, place of the root.
        fps: frames per second; frame k shows the time k / fps.
        meta: how the motion was made, see `Motion.meta`.
    """

    armature: Armature
    rotations: np.ndarray
    translation: np.ndarray
    fps: float
    meta: dict[str, Any]

    @property
    def num_frames(self) -> int:
        return len(self.rotations)


def world(animation: Animation) -> tuple[np.ndarray, np.ndarray]:
    """Forward kinematics.

    Returns:
        (T, J, 4) rotations and (T, J, 3) positions in metres, both in the world.
    """
    armature, local = animation.armature, animation.rotations
    turned = np.empty(local.shape)
    positions = np.empty((*local.shape[:2], 3))
    for joint, parent in enumerate(armature.parents):
        if parent < 0:
            turned[:, joint], positions[:, joint] = local[:, joint], animation.translation
            continue
        turned[:, joint] = rotations.multiply(turned[:, parent], local[:, joint])
        offset = rotations.rotate(turned[:, parent], armature.offsets[joint])
        positions[:, joint] = positions[:, parent] + offset
    return turned, positions


def export_axes(skeleton: Skeleton) -> np.ndarray:
    """(3,) signs that turn vectors in the skeleton's axes into those of this module, and back.

    y down becomes y up. TED-Expressive has the person's left at +x and faces -z, TED-Gesture the other way round.
    """
    left, right = (skeleton.mean_pose[skeleton.joint(f"{side}_shoulder"), 0] for side in ("left", "right"))
    return np.array([1.0, -1.0, -1.0]) if left > right else np.array([-1.0, -1.0, 1.0])


def ha2g_armature(skeleton: Skeleton) -> Armature:
    """The armature of a skeleton, with its bone lengths, in a T-pose: palms down, fingers along the arm, head up.

    At rest no joint is turned. All joints of the skeleton are joints here, at the same places. Where several bones
    leave one joint, each has a joint of its own there, with no offset, that turns it: left_clavicle; head, from the
    neck to the nose (nose_0 in TED-Gesture, where head is the top of the head); left_eye_0; left_index_0 and so on,
    each with its other side. A joint at the end of a chain is never turned.
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
            turning = add(_carrier(skeleton, name), index, np.zeros(3)) if len(bones) > 1 else index
            grow(child, add(name, turning, float(skeleton.lengths[bone]) * directions[bone]))

    grow(0, 0)
    rest = np.tile(rotations.IDENTITY, (len(joints), 1))
    return Armature("ha2g", tuple(joints), tuple(parents), np.array(offsets), rest)


def carriers(skeleton: Skeleton) -> tuple[str, ...]:
    """For each bone of the skeleton the joint of `ha2g_armature` that turns it."""
    starts = [parent for parent, _ in skeleton.bones]
    return tuple(
        _carrier(skeleton, skeleton.joints[child]) if starts.count(parent) > 1 else skeleton.joints[parent]
        for parent, child in skeleton.bones
    )


def _carrier(skeleton: Skeleton, child: str) -> str:
    """Name of a joint that turns one of several bones, the one to `child`."""
    name = _CARRIERS.get(child)
    if name is not None and name not in skeleton.joints:
        return name
    return f"{child.removesuffix('_1')}_0"


def rest_directions(skeleton: Skeleton) -> np.ndarray:
    """(bones, 3) unit vectors of the bones in the T-pose.

    Trunk, arms and fingers are straight. Collarbones and face lie as in the data's mean pose, made symmetric, and so do
    the bones within the hand, turned so that the middle finger's lies along the arm and the palm is level.
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
    """Unit vectors of the bones of a left hand along +x, palm down, by the joint at their end without its side."""
    fan = {finger: mean[skeleton.bone(f"left_{finger}_1")] for finger in (*FOUR_FINGERS, "thumb")}
    along = fan["middle"]
    back = rotations.unit(np.cross(fan["index"] - fan["pinky"], along))
    axes = np.stack([along, back, np.cross(along, back)])
    directions = {f"{finger}_1": rotations.unit(axes @ vector) for finger, vector in fan.items()}
    for part in (2, 3):
        directions |= {f"{finger}_{part}": LEFT for finger in FOUR_FINGERS}
        directions[f"thumb_{part}"] = directions["thumb_1"]
    return directions
