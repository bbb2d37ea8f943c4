"""Rotations for the bones of an armature of any rest pose, bone axes and orientation.

The rotation D of a joint from its rest pose in the world is converted to the axes of the armature. Where the rest pose
of the armature is not a T-pose, the bone is first rotated by C, so that arms and fingers have the directions of the
motion: an arm that hangs at 45 degrees at rest is raised first. Trunk, head and collarbones keep their rest pose.
"""

import dataclasses
import re

import numpy as np

from . import rotations
from .bone_names import Names, roles
from .motion import Motion, MotionError

_NEAR = np.cos(np.radians(25))
_ARM = re.compile(r"(left|right)_(shoulder|elbow|(index|middle|ring|pinky|thumb)_[123])")


@dataclasses.dataclass(frozen=True)
class Target:
    """The bones of an armature at rest, in the armature's axes.

    Attributes:
        bones: names of the bones, each after its parent.
        parents: index of the parent of each bone, -1 for none.
        heads: (B, 3) positions of the heads of the bones.
        rest: (B, 4) orientations of the bones, as x, y, z, w.
        inherits: whether each bone rotates with its parent.
    """

    bones: tuple[str, ...]
    parents: tuple[int, ...]
    heads: np.ndarray
    rest: np.ndarray
    inherits: tuple[bool, ...]


def fit(motion: Motion, target: Target, names: Names) -> dict[str, np.ndarray]:
    """Compute rotations of bones in their own axes, relative to rest and parent, as those of a pose bone.

    Args:
        motion: motion with the joints.
        target: bones of the armature.
        names: joint and weight by bone, see `bone_names.match`.

    Returns:
        (T, 4) rotations x, y, z, w by bone, with signs that are continuous over time.

    Raises:
        MotionError: the upper arms are not among the bones.
    """
    facing = _facing(motion, target, names)
    joints = {bone: motion.joints.index(joint) for bone, (joint, _) in names.items()}
    corrections = _corrections(motion, target, names, joints, rotations.conjugate(facing))
    wanted: dict[int, np.ndarray] = {}
    # The rotation of the nearest bone above with weight 1, from which a smaller weight is counted.
    whole: list[np.ndarray] = []
    for index, (bone, parent) in enumerate(zip(target.bones, target.parents)):
        above = whole[parent] if parent >= 0 else rotations.IDENTITY
        if bone not in names:
            whole.append(above)
            continue
        rotation, weight = motion.rotations[:, joints[bone]], names[bone][1]
        whole.append(rotation if weight == 1 else above)
        rotation = (
            rotation if weight == 1 else rotations.slerp(np.broadcast_to(above, rotation.shape), rotation, weight)
        )
        rotation = rotations.multiply(rotation, corrections[index])
        wanted[index] = rotations.multiply(rotations.multiply(facing, rotation), rotations.conjugate(facing))
    return local(target, wanted, motion.num_frames)


def local(target: Target, wanted: dict[int, np.ndarray], frames: int) -> dict[str, np.ndarray]:
    """Convert rotations of bones in the axes of the armature to rotations in the axes of the bones.

    Args:
        target: bones of the armature.
        wanted: (T, 4) rotations from rest in the axes of the armature, by the index of the bone.
        frames: number of frames T.

    Returns:
        (T, 4) rotations relative to rest and parent, by bone, with signs that are continuous over time.
    """
    rotated: list[np.ndarray] = []
    found: dict[str, np.ndarray] = {}
    for index, (parent, inherits) in enumerate(zip(target.parents, target.inherits)):
        above = rotated[parent] if parent >= 0 and inherits else np.broadcast_to(rotations.IDENTITY, (frames, 4))
        rotated.append(wanted.get(index, above))
        if index in wanted:
            rotation = rotations.multiply(rotations.conjugate(above), wanted[index])
            own = rotations.multiply(rotations.conjugate(target.rest[index]), rotation)
            own = rotations.multiply(own, target.rest[index])
            found[target.bones[index]] = rotations.continuous(rotations.unit(own))
    return found


def _facing(motion: Motion, target: Target, names: Names) -> np.ndarray:
    """Return the rotation (4,) from the axes of the motion to those of the armature, from left and up at rest."""
    carried = roles(motion)
    own = {name: motion.joints.index(joint) for joint, name in carried.items()}
    bones = {carried[joint]: target.bones.index(bone) for bone, (joint, weight) in names.items() if weight == 1}
    if not {"left_shoulder", "right_shoulder"} <= set(bones):
        raise MotionError("no bone has the joint left_shoulder or right_shoulder; name the upper arms (--names)")
    trunk = [target.bones.index(bone) for bone, (joint, _) in names.items() if carried[joint] == "spine"]
    bottom = min(trunk, default=_ancestors(target, bones["left_shoulder"])[-1])
    theirs, ours = _axes(target.heads, bones, bottom), _axes(motion.places, own, 0)
    return rotations.from_matrix(theirs @ ours.T)


def _axes(places: np.ndarray, joints: dict[str, int], bottom: int) -> np.ndarray:
    """Return the directions of a figure at rest as a (3, 3) matrix with the columns left, up and forward."""
    left, right = (places[joints[f"{side}_shoulder"]] for side in ("left", "right"))
    up = _snapped((left + right) / 2 - places[bottom])
    across = left - right
    across = across - (across @ up) * up
    if np.linalg.norm(across) < 1e-9:
        raise MotionError(
            "the armature's shoulders and spine lie on one line, so its front is unknown; name other bones"
        )
    across = _snapped(across) if np.abs(up).max() == 1 else rotations.unit(across)
    return np.stack([across, up, np.cross(across, up)], axis=1)


def _snapped(vector: np.ndarray) -> np.ndarray:
    """Return the axis that a vector is near to, because a spine is not exactly vertical, or else its unit vector."""
    vector = rotations.unit(vector)
    near = np.where(np.abs(vector) > _NEAR, np.sign(vector), 0.0)
    return near if near.any() else vector


def _corrections(
    motion: Motion, target: Target, names: Names, joints: dict[str, int], to_motion: np.ndarray
) -> np.ndarray:
    """Return the rotation C (B, 4) of each bone from its rest pose to that of the motion, in the motion's axes."""
    heads = rotations.rotate(to_motion, target.heads)
    places = motion.places
    carried = roles(motion)
    by_bone = {bone: carried[joint] for bone, (joint, weight) in names.items() if weight == 1}
    bones = {name: target.bones.index(bone) for bone, name in by_bone.items()}
    found = np.tile(rotations.IDENTITY, (len(target.bones), 1))
    hands = {side: _hand(side, heads, places, bones, by_bone, joints) for side in ("left", "right")}
    for index, (bone, parent) in enumerate(zip(target.bones, target.parents)):
        found[index] = found[parent] if parent >= 0 else rotations.IDENTITY
        name = by_bone.get(bone, "")
        side, _, part = name.partition("_")
        hand = hands.get(side)
        if part == "wrist" and hand is not None:
            found[index] = hand
        elif _ARM.fullmatch(name):
            if part == "elbow" and hand is not None:
                found[index] = hand  # so that the forearm is twisted as the hand is
            child = _next(target, index, by_bone, places, joints)
            if child is not None:
                ours = places[joints[target.bones[child]]] - places[joints[bone]]
                theirs = rotations.rotate(found[index], heads[child] - heads[index])
                found[index] = rotations.multiply(rotations.between(theirs, ours), found[index])
    return found


def _hand(
    side: str,
    heads: np.ndarray,
    places: np.ndarray,
    bones: dict[str, int],
    roles: dict[str, str],
    joints: dict[str, int],
) -> np.ndarray | None:
    """Return the rotation (4,) from the frame of the hand at rest to that of the motion, or None without knuckles."""
    knuckles = [f"{side}_{name}" for name in ("wrist", "index_1", "middle_1", "pinky_1")]
    if not set(knuckles) <= set(bones):
        return None
    by_role = {name: joints[bone] for bone, name in roles.items()}
    theirs, ours = (
        _frame(*(points[index[name]] for name in knuckles)) for points, index in ((heads, bones), (places, by_role))
    )
    return rotations.from_matrix(ours @ theirs.T)


def _frame(wrist: np.ndarray, first: np.ndarray, middle: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Return the frame of a hand as a (3, 3) matrix with the columns along the hand, out of its back and across."""
    along = rotations.unit(middle - wrist)
    across = rotations.unit(np.cross(first - last, along))
    return np.stack([along, across, np.cross(along, across)], axis=1)


def _next(target: Target, index: int, roles: dict[str, str], places: np.ndarray, joints: dict[str, int]) -> int | None:
    """Return the first bone below that is assigned to a joint at another position, the end of this bone."""
    for below in range(index + 1, len(target.bones)):
        bone = target.bones[below]
        if bone in roles and index in _ancestors(target, below)[1:]:
            distance = places[joints[bone]] - places[joints[target.bones[index]]]
            return below if np.linalg.norm(distance) > 1e-6 else None
    return None


def _ancestors(target: Target, index: int) -> list[int]:
    """Return the indices of a bone, its parent, and so on to the top."""
    found = [index]
    while target.parents[found[-1]] >= 0:
        found.append(target.parents[found[-1]])
    return found
