"""Rigs: the same animation on the joints of another program, by a table in `assets/rigs/`.

A table has a line for each joint: its name and parent; the joint of the `ha2g` armature that it `carries`, whose
rotation in the world it takes, or null for a joint that stays at rest; the joint whose `place` it has, or null to lie
at its `offset` from its parent (metres in the T-pose, world axes); `share`, how much of the rotation it takes where
several joints share one, as those of the spine do; `rest`, its orientation in the rig's rest pose; and where the rest
pose is not ours, `t_pose`, its orientation in our T-pose, or `direction`, where its bone points at rest.
"""

import dataclasses
import functools
import importlib.resources
import json

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.motion import rotations
from ha2g_jax.motion.armature import Animation, Armature, ha2g_armature, world
from ha2g_jax.skeleton import load_skeleton

OWN = "ha2g"
RIGS = (OWN, "mixamo", "unreal", "unity", "vrm", "smplx")

# The joint that turns the head, where the skeleton has a joint of that name already.
_OTHER_NAMES = {"head": "nose_0"}


@dataclasses.dataclass(frozen=True)
class RigJoint:
    """One line of a table; the module says what each field means.

    Attributes:
        parent: index in the table, -1 for the root.
        offset: (3,) metres.
        rest: (4,) orientation in the world.
        t_pose: (4,) orientation in the world, or None.
        direction: (3,) unit vector in the world, or None.
    """

    name: str
    parent: int
    carries: str | None
    place: str | None
    offset: np.ndarray
    share: float = 1.0
    rest: np.ndarray = dataclasses.field(default_factory=lambda: rotations.IDENTITY)
    t_pose: np.ndarray | None = None
    direction: np.ndarray | None = None


@dataclasses.dataclass(frozen=True)
class Rig:
    """A table.

    Attributes:
        name: one of `RIGS`.
        has_own_lengths: whether bones are as long as in the table; else as long as in the motion.
        joints: each after its parent; joint 0 is the root.
    """

    name: str
    has_own_lengths: bool
    joints: tuple[RigJoint, ...]

    @property
    def names(self) -> dict[str, str]:
        """The rig's name of each `ha2g` joint that it has: the joint that takes all of its rotation."""
        return {joint.carries: joint.name for joint in self.joints if joint.carries and joint.share == 1}


@functools.cache
def load_rig(name: str) -> Rig:
    """The rig stored under `name`, one of `RIGS`; "ha2g" is that of TED-Expressive's joints.

    Raises:
        UserError: no such rig.
    """
    if name == OWN:
        armature = ha2g_armature(load_skeleton("ted_expressive"))
        rows = zip(armature.joints, armature.parents, armature.offsets, strict=True)
        return Rig(OWN, False, tuple(RigJoint(joint, parent, joint, joint, offset) for joint, parent, offset in rows))
    if name not in RIGS:
        raise UserError(f"no rig {name}; expected one of {', '.join(RIGS)}")
    table = json.loads((importlib.resources.files("ha2g_jax") / "assets" / "rigs" / f"{name}.json").read_text())
    indices: dict[str | None, int] = {None: -1}
    joints = []
    for row in table["joints"]:
        vectors = {key: rotations.unit(row[key]) for key in ("rest", "t_pose", "direction") if row.get(key) is not None}
        joints.append(
            RigJoint(
                row["name"],
                indices[row["parent"]],
                row["carries"],
                row["place"],
                np.array(row["offset"], np.float64),
                row.get("share", 1.0),
                **vectors,
            )
        )
        indices[row["name"]] = len(joints) - 1
    return Rig(table["name"], table["proportions"] == "table", tuple(joints))


def retarget(animation: Animation, rig: Rig) -> Animation:
    """The animation on another rig.

    Joints that carry one of ours turn in the world as it does; the bones between joints that have the place of ours
    point where ours point. So the positions of those joints relative to the chest's are ours where the rig takes the
    motion's lengths, but for the knuckles of rigs without bones in the palm (they ride on a stiff hand) and for what
    hangs on a table's own lengths. The joints below the chest share its rotation, so that the chest moves a little;
    hips and legs stand in the rest pose on the ground, y = 0.

    Args:
        animation: of the `ha2g` armature.
        rig: which rig; "ha2g" returns the animation as it is.

    Returns:
        An animation of an armature named after the rig.
    """
    if rig.name == animation.armature.name:
        return animation
    places, turns, rest = _rest_pose(animation.armature, rig)
    parents = tuple(joint.parent for joint in rig.joints)
    armature = _armature(rig, places, rest)
    sources, _ = world(animation)
    found = [_source(animation.armature, joint.carries) for joint in rig.joints]
    turned = np.empty((animation.num_frames, len(rig.joints), 4))
    local = np.empty_like(turned)
    # What the nearest joint above takes in full, from which a share is counted.
    whole: list[np.ndarray] = []
    for index, (joint, parent, source) in enumerate(zip(rig.joints, parents, found)):
        above = whole[parent] if parent >= 0 else rotations.IDENTITY
        if source is None:
            whole.append(above)
            local[:, index] = armature.rest[index]
        else:
            turn = sources[:, source]
            turn = turn if joint.share == 1 else rotations.slerp(above, turn, np.array(joint.share))
            whole.append(turn if joint.share == 1 else np.broadcast_to(above, turn.shape))
            wanted = rotations.multiply(turn, rotations.multiply(rotations.conjugate(turns[index]), rest[index]))
            local[:, index] = _relative(turned[:, parent], wanted) if parent >= 0 else wanted
        turned[:, index] = rotations.multiply(turned[:, parent], local[:, index]) if parent >= 0 else local[:, index]
    local = rotations.continuous(rotations.unit(local))
    return Animation(armature, local, places[0] + animation.translation, animation.fps, animation.meta)


def carriers(armature: Armature) -> dict[str, int]:
    """Index of the joint of an armature of this package that turns as each `ha2g` joint does."""
    if armature.name == OWN:
        own = {name: index for index, name in enumerate(armature.joints)}
        return own | {name: own[other] for name, other in _OTHER_NAMES.items() if other in own}
    return {ours: armature.joint(name) for ours, name in load_rig(armature.name).names.items()}


def places(armature: Armature) -> dict[str, int]:
    """Index of the joint of an armature of this package that has the place of each `ha2g` joint."""
    if armature.name == OWN:
        return {name: index for index, name in enumerate(armature.joints)}
    return {joint.place: index for index, joint in enumerate(load_rig(armature.name).joints) if joint.place}


def rest_positions(armature: Armature) -> tuple[np.ndarray, np.ndarray]:
    """(J, 4) orientations and (J, 3) positions in metres of an armature at rest, its root at the origin."""
    still = Animation(armature, armature.rest[None], np.zeros((1, 3)), 1.0, {})
    turned, positions = world(still)
    return turned[0], positions[0]


def _rest_pose(armature: Armature, rig: Rig) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places (J, 3) and orientations (J, 4) of the rig's joints at rest, and how they are turned from our T-pose."""
    _, ours = rest_positions(armature)
    straight = _t_pose(armature, ours, rig)
    children = [next((i for i, joint in enumerate(rig.joints) if joint.parent == k), k) for k in range(len(rig.joints))]
    turns = np.tile(rotations.IDENTITY, (len(rig.joints), 1))
    at_rest = np.zeros((len(rig.joints), 3))
    for index, joint in enumerate(rig.joints):
        if joint.parent >= 0:
            turns[index] = turns[joint.parent]
        if joint.t_pose is not None:
            turns[index] = rotations.multiply(joint.rest, rotations.conjugate(joint.t_pose))
        elif joint.direction is not None:
            bone = rotations.rotate(turns[index], straight[children[index]] - straight[index])
            if np.linalg.norm(bone) > 0:
                turns[index] = rotations.multiply(rotations.between(bone, joint.direction), turns[index])
        if joint.parent < 0:
            at_rest[index] = straight[index]
        elif rig.has_own_lengths:
            at_rest[index] = at_rest[joint.parent] + joint.offset
        else:
            bone = rotations.rotate(turns[joint.parent], straight[index] - straight[joint.parent])
            at_rest[index] = at_rest[joint.parent] + bone
    return at_rest, turns, np.array([joint.rest for joint in rig.joints])


def _t_pose(armature: Armature, ours: np.ndarray, rig: Rig) -> np.ndarray:
    """(J, 3) places of the rig's joints in our T-pose, with the motion's lengths where it has the joints."""
    straight = np.zeros((len(rig.joints), 3))
    shift = None
    for index, joint in enumerate(rig.joints):
        above = straight[joint.parent] if joint.parent >= 0 else np.zeros(3)
        straight[index] = above + joint.offset
        if joint.place in armature.joints:
            place = ours[armature.joint(joint.place)]
            shift = straight[index] - place if shift is None else shift
            straight[index] = place + shift
    return straight


def _armature(rig: Rig, at_rest: np.ndarray, rest: np.ndarray) -> Armature:
    offsets, local = np.zeros_like(at_rest), rest.copy()
    for index, joint in enumerate(rig.joints):
        if joint.parent >= 0:
            back = rotations.conjugate(rest[joint.parent])
            offsets[index] = rotations.rotate(back, at_rest[index] - at_rest[joint.parent])
            local[index] = rotations.multiply(back, rest[index])
    names = tuple(joint.name for joint in rig.joints)
    return Armature(rig.name, names, tuple(joint.parent for joint in rig.joints), offsets, local)


def _source(armature: Armature, name: str | None) -> int | None:
    """Index of the joint that turns as our joint `name` does, where the armature has it."""
    name = _OTHER_NAMES.get(name or "", name) if _OTHER_NAMES.get(name or "") in armature.joints else name
    return armature.joint(name) if name in armature.joints else None


def _relative(parent: np.ndarray, child: np.ndarray) -> np.ndarray:
    return rotations.multiply(rotations.conjugate(parent), child)
