"""Rotations for the bones of an armature, whatever its rest pose, bone axes and orientation are.

A joint's rotation D from its rest pose, in the world, is turned into the armature's axes. Where the armature's rest
pose is not a T-pose, the bone is first turned by C, so that arms and fingers point where the motion's do: an arm that
hangs at 45 degrees at rest is lifted before it is turned. Trunk, head and collarbones keep their own rest pose.
"""

import dataclasses
import re

import numpy as np

from . import rotations
from .bone_names import Names, role
from .motion import Motion, MotionError

_NEAR = np.cos(np.radians(25))
_ARM = re.compile(r"(left|right)_(shoulder|elbow|(index|middle|ring|pinky|thumb)_[123])")


@dataclasses.dataclass(frozen=True)
class Target:
    """The bones of an armature at rest, in the armature's axes.

    Attributes:
        bones: names, each after its parent.
        parents: index of the parent, -1 for none.
        heads: (B, 3) where they begin.
        rest: (B, 4) their axes; x, y, z, w.
        inherits: whether a bone turns with its parent.
    """

    bones: tuple[str, ...]
    parents: tuple[int, ...]
    heads: np.ndarray
    rest: np.ndarray
    inherits: tuple[bool, ...]


def fit(motion: Motion, target: Target, names: Names) -> dict[str, np.ndarray]:
    """Return rotations of the named bones in their own axes, relative to rest and parent, as a pose bone has them.

    Args:
        names: joint and share by bone, see `bone_names.match`.

    Returns:
        (T, 4) x, y, z, w by bone, sign-continuous.

    Raises:
        MotionError: the upper arms are not among the bones.
    """
    facing = _facing(motion, target, names)
    joints = {bone: motion.joints.index(joint) for bone, (joint, _) in names.items()}
    corrections = _corrections(motion, target, names, joints, rotations.conjugate(facing))
    wanted: dict[int, np.ndarray] = {}
    # What the nearest bone above takes in full, from which a share is counted.
    whole: list[np.ndarray] = []
    for index, (bone, parent) in enumerate(zip(target.bones, target.parents)):
        above = whole[parent] if parent >= 0 else rotations.IDENTITY
        if bone not in names:
            whole.append(above)
            continue
        turn, share = motion.turns[:, joints[bone]], names[bone][1]
        whole.append(turn if share == 1 else above)
        turn = turn if share == 1 else rotations.slerp(np.broadcast_to(above, turn.shape), turn, share)
        turn = rotations.multiply(turn, corrections[index])
        wanted[index] = rotations.multiply(rotations.multiply(facing, turn), rotations.conjugate(facing))
    return local(target, wanted, motion.num_frames)


def local(target: Target, wanted: dict[int, np.ndarray], frames: int) -> dict[str, np.ndarray]:
    """Return how bones turn in their own axes, if in the armature's axes they shall turn from rest by `wanted` (T, 4)."""
    turned: list[np.ndarray] = []
    found: dict[str, np.ndarray] = {}
    for index, (parent, inherits) in enumerate(zip(target.parents, target.inherits)):
        above = turned[parent] if parent >= 0 and inherits else np.broadcast_to(rotations.IDENTITY, (frames, 4))
        turned.append(wanted.get(index, above))
        if index in wanted:
            turn = rotations.multiply(rotations.conjugate(above), wanted[index])
            own = rotations.multiply(rotations.conjugate(target.rest[index]), turn)
            own = rotations.multiply(own, target.rest[index])
            found[target.bones[index]] = rotations.continuous(rotations.unit(own))
    return found


def _facing(motion: Motion, target: Target, names: Names) -> np.ndarray:
    """Return the rotation (4,) from the motion's axes to the armature's: where the figure at rest has its left and its up."""
    bones = {role(motion, joint): target.bones.index(bone) for bone, (joint, share) in names.items() if share == 1}
    if not {"left_shoulder", "right_shoulder"} <= set(bones):
        raise MotionError("no bone turns as left_shoulder, or none as right_shoulder; name the upper arms (--names)")
    left, right = (target.heads[bones[f"{side}_shoulder"]] for side in ("left", "right"))
    trunk = [target.bones.index(bone) for bone, (joint, _) in names.items() if role(motion, joint) == "spine"]
    bottom = min(trunk, default=_ancestors(target, bones["left_shoulder"])[-1])
    up = _snapped((left + right) / 2 - target.heads[bottom])
    across = left - right
    across = across - (across @ up) * up
    if np.linalg.norm(across) < 1e-9:
        raise MotionError("the armature's shoulders and spine lie on one line; it has no front")
    across = _snapped(across) if np.abs(up).max() == 1 else rotations.unit(across)
    return rotations.from_matrix(np.stack([across, up, np.cross(across, up)], axis=1))


def _snapped(vector: np.ndarray) -> np.ndarray:
    """Return the axis that a vector is near to, or itself at length 1: a spine leans a little, a character stands straight."""
    vector = rotations.unit(vector)
    near = np.where(np.abs(vector) > _NEAR, np.sign(vector), 0.0)
    return near if near.any() else vector


def _corrections(
    motion: Motion, target: Target, names: Names, joints: dict[str, int], to_motion: np.ndarray
) -> np.ndarray:
    """Return (B, 4) C of each bone in the motion's axes: from the armature's rest pose to the motion's."""
    heads = rotations.rotate(to_motion, target.heads)
    places = motion.places
    roles = {bone: role(motion, joint) for bone, (joint, share) in names.items() if share == 1}
    bones = {name: target.bones.index(bone) for bone, name in roles.items()}
    found = np.tile(rotations.IDENTITY, (len(target.bones), 1))
    hands = {side: _hand(side, heads, places, bones, roles, joints) for side in ("left", "right")}
    for index, (bone, parent) in enumerate(zip(target.bones, target.parents)):
        found[index] = found[parent] if parent >= 0 else rotations.IDENTITY
        name = roles.get(bone, "")
        side, _, part = name.partition("_")
        hand = hands.get(side)
        if part == "wrist" and hand is not None:
            found[index] = hand
        elif _ARM.fullmatch(name):
            if part == "elbow" and hand is not None:
                found[index] = hand  # so that the forearm is twisted as the hand is
            child = _next(target, index, roles, places, joints)
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
    """Return the rotation (4,) from the hand's frame at rest to the motion's, or None without knuckles."""
    knuckles = [f"{side}_{name}" for name in ("wrist", "index_1", "middle_1", "pinky_1")]
    if not set(knuckles) <= set(bones):
        return None
    by_role = {name: joints[bone] for bone, name in roles.items()}
    theirs, ours = (
        _frame(*(points[index[name]] for name in knuckles)) for points, index in ((heads, bones), (places, by_role))
    )
    return rotations.from_matrix(ours @ theirs.T)


def _frame(wrist: np.ndarray, first: np.ndarray, middle: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Return (3, 3) columns along the hand, out of its back and across."""
    along = rotations.unit(middle - wrist)
    across = rotations.unit(np.cross(first - last, along))
    return np.stack([along, across, np.cross(along, across)], axis=1)


def _next(target: Target, index: int, roles: dict[str, str], places: np.ndarray, joints: dict[str, int]) -> int | None:
    """Return the first bone below with a role, whose joint lies elsewhere: the end of this bone."""
    for below in range(index + 1, len(target.bones)):
        bone = target.bones[below]
        if bone in roles and index in _ancestors(target, below)[1:]:
            distance = places[joints[bone]] - places[joints[target.bones[index]]]
            return below if np.linalg.norm(distance) > 1e-6 else None
    return None


def _ancestors(target: Target, index: int) -> list[int]:
    """Return the bone itself, its parent, and so on to the top."""
    found = [index]
    while target.parents[found[-1]] >= 0:
        found.append(target.parents[found[-1]])
    return found
