"""Rigs, the joints of other programs, each a table in `assets/rigs/`, and the transfer of an animation to a rig.

Each file `assets/rigs/NAME.json` is a rig of that name; a new file is a new rig. It has the rig's `name`, a `comment`,
`proportions` ("motion" for the bone lengths of the motion, "table" for those of the file) and `joints`, a list in
which each joint comes after its parent. The first joint is the root. A joint has these fields:

- `name`: the rig's name of the joint.
- `parent`: name of its parent, null for the root.
- `carries`: joint of the `ha2g` armature whose rotation in the world it takes; null for a joint that stays at rest.
- `place`: joint of the `ha2g` armature at whose position it lies; null for a joint at its `offset` from its parent.
- `offset`: [x, y, z] metres from its parent in the T-pose, in the axes of the world.
- `weight`: fraction of the rotation that it takes, for several joints that divide one rotation, as those of a spine
  do; 1 by default.
- `rest`: orientation in the world in the rig's rest pose, as a quaternion [x, y, z, w]; no rotation by default.
- `t_pose`: orientation in the world in the T-pose, where the rest pose of the rig is another pose.
- `direction`: [x, y, z] direction of its bone in the rest pose, in place of `t_pose`.
"""

import dataclasses
import functools
import importlib.resources
import json

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import reason
from ha2g_jax.motion import rotations
from ha2g_jax.motion.armature import Animation, Armature, ha2g_armature, relative, rest_positions, world
from ha2g_jax.motion.lower_body import JOINTS as LOWER_JOINTS
from ha2g_jax.skeleton import load_skeleton

OWN = "ha2g"
_TABLES = importlib.resources.files("ha2g_jax") / "assets" / "rigs"
RIGS = (OWN, *sorted(file.name.removesuffix(".json") for file in _TABLES.iterdir() if file.name.endswith(".json")))

# Joints whose rotation another joint has, where the skeleton has a joint of that name for another purpose.
OTHER_NAMES = {"head": "nose_0"}
PELVIS = LOWER_JOINTS[0]


@dataclasses.dataclass(frozen=True)
class RigJoint:
    """One joint of a rig, see above."""

    name: str
    parent: int
    carries: str | None
    place: str | None
    offset: np.ndarray
    weight: float = 1.0
    rest: np.ndarray = dataclasses.field(default_factory=lambda: rotations.IDENTITY)
    t_pose: np.ndarray | None = None
    direction: np.ndarray | None = None


@dataclasses.dataclass(frozen=True)
class Rig:
    """The joints of another program, each after its parent; the bones have the motion's lengths or the file's own."""

    name: str
    has_own_lengths: bool
    joints: tuple[RigJoint, ...]

    @property
    def names(self) -> dict[str, str]:
        """Names of the rig's joints that take all of the rotation of a `ha2g` joint, by the name of the latter."""
        return {joint.carries: joint.name for joint in self.joints if joint.carries and joint.weight == 1}


@functools.cache
def load_rig(name: str) -> Rig:
    """Load one of `RIGS`; "ha2g" is the rig of the joints of TED-Expressive.

    Raises:
        UserError: there is no such rig, or its table cannot be used.
    """
    if name == OWN:
        armature = ha2g_armature(load_skeleton("ted_expressive"))
        rows = zip(armature.joints, armature.parents, armature.offsets, strict=True)
        return Rig(OWN, False, tuple(RigJoint(joint, parent, joint, joint, offset) for joint, parent, offset in rows))
    if name not in RIGS:
        raise UserError(f"no rig {name}; expected one of {', '.join(RIGS)}")
    try:
        return _read_rig(name)
    except (KeyError, TypeError, ValueError) as error:
        raise UserError(f"the rig {name} cannot be read ({reason(error)}); correct its table {name}.json") from error


def _read_rig(name: str) -> Rig:
    table = json.loads((_TABLES / f"{name}.json").read_text(encoding="utf-8"))
    if table["name"] != name:
        raise ValueError(f"its name is {table['name']}")
    known = {None, *(joint.name for joint in load_rig(OWN).joints), *LOWER_JOINTS, *OTHER_NAMES}
    indices: dict[str | None, int] = {None: -1}
    joints = []
    for row in table["joints"]:
        if unknown := {row["carries"], row["place"]} - known:
            raise ValueError(f"{row['name']} carries or has the place of {unknown.pop()}, which is no joint of {OWN}")
        vectors = {key: rotations.unit(row[key]) for key in ("rest", "t_pose", "direction") if row.get(key) is not None}
        joints.append(
            RigJoint(
                row["name"],
                indices[row["parent"]],
                row["carries"],
                row["place"],
                np.array(row["offset"], np.float64),
                row.get("weight", 1.0),
                **vectors,
            )
        )
        indices[row["name"]] = len(joints) - 1
    return Rig(table["name"], table["proportions"] == "table", tuple(joints))


def carriers(armature: Armature) -> dict[str, int]:
    """Return the index of the joint that rotates as each `ha2g` joint does, by the name of the latter."""
    if armature.name == OWN:
        own = {name: index for index, name in enumerate(armature.joints)}
        return own | {name: own[other] for name, other in OTHER_NAMES.items() if other in own}
    return {ours: armature.joint(name) for ours, name in load_rig(armature.name).names.items()}


def places(armature: Armature) -> dict[str, int]:
    """Return the index of the joint that has the place of each `ha2g` joint, by the name of the latter."""
    if armature.name == OWN:
        return {name: index for index, name in enumerate(armature.joints)}
    return {joint.place: index for index, joint in enumerate(load_rig(armature.name).joints) if joint.place}


def armature_of(rig: Rig, own: Armature) -> Armature:
    """Return the armature of a rig with the lengths of an `ha2g` armature, where the rig has none of its own."""
    return own if rig.name == own.name else Transfer.between(own, rig).armature


def retarget(animation: Animation, rig: Rig) -> Animation:
    """Transfer an animation of the `ha2g` armature to another rig.

    Joints that carry a `ha2g` joint take its rotation in the world. Bones between joints that have the places of
    `ha2g` joints point in the same directions as there. So the positions of those joints relative to the chest are
    the same where the rig takes the motion's bone lengths, except for the knuckles of rigs without bones in the
    palm, whose hand is rigid, and for joints below a bone of the table's own length. The joints of the spine divide
    the rotation of the chest, so that the chest moves a little; on a pelvis it is at its place on average. Where
    the armature has a pelvis and legs, the rig's pelvis is at its place, which is not scaled to legs of another
    length. Otherwise hips and legs stay in the rest pose and stand on the ground, y = 0.

    The armature of the result has the name of the rig; for "ha2g" the result is the animation itself.
    """
    if rig.name == animation.armature.name:
        return animation
    found = Transfer.between(animation.armature, rig).apply(animation)
    has_pelvis = animation.armature.joints[0] == PELVIS
    return found if rig.has_own_lengths or not has_pelvis else _with_mean_chest(found, animation)


def _with_mean_chest(found: Animation, animation: Animation) -> Animation:
    """Move the chest of a rig, below joints that divide its rotation, to where it is in an animation on average.

    The offset of the chest from the pelvis in the `ha2g` armature is that of the bent spine, and the rig bends it.
    """
    armature, chest = found.armature, places(found.armature)["spine"]
    turned, at = world(found)
    true = world(animation)[1][:, animation.armature.joint("spine")]
    back = rotations.conjugate(turned[:, armature.parents[chest]])
    offsets = armature.offsets.copy()
    offsets[chest] += rotations.rotate(back, true - at[:, chest]).mean(axis=0)
    return dataclasses.replace(found, armature=dataclasses.replace(armature, offsets=offsets))


@dataclasses.dataclass(frozen=True)
class Transfer:
    """The part of `retarget` that is the same for all frames, for motion that arrives frame by frame.

    Attributes:
        armature: armature of the rig, with J joints.
        start: (3,) metres from the root of the `ha2g` armature to that of the rig: of an armature without pelvis, whose
            root stays at the origin, the position of the rig's root at rest.
        carried: (K,) indices of the joints that carry a joint of the `ha2g` armature.
        sources: (K,) indices of the joints that they carry.
        weights: (K,) fractions of the rotations that they take.
        above: (K,) indices of the `ha2g` joints from whose rotation these fractions are counted, -1 for no rotation.
        from_source: (K, 4) orientations of the joints relative to those of the joints that they carry.
    """

    armature: Armature
    start: np.ndarray
    carried: np.ndarray
    sources: np.ndarray
    weights: np.ndarray
    above: np.ndarray
    from_source: np.ndarray

    @classmethod
    def between(cls, armature: Armature, rig: Rig) -> "Transfer":
        """Prepare the transfer from the `ha2g` armature of a skeleton to any other rig."""
        places, to_rest, rest = _rest_pose(armature, rig)
        ours = carriers(armature)
        found = [ours.get(joint.carries or "") for joint in rig.joints]
        above: list[int] = []  # the source of the nearest joint above that takes a whole rotation
        for joint in rig.joints:
            source = found[joint.parent] if joint.parent >= 0 and rig.joints[joint.parent].weight == 1 else None
            above.append(-1 if joint.parent < 0 else above[joint.parent] if source is None else source)
        carried = np.array([index for index, source in enumerate(found) if source is not None])
        return cls(
            armature=_armature(rig, places, rest),
            start=places[0] - _pelvis(armature, rig, places),
            carried=carried,
            sources=np.array([source for source in found if source is not None]),
            weights=np.array([rig.joints[index].weight for index in carried]),
            above=np.array(above)[carried],
            from_source=rotations.multiply(rotations.conjugate(to_rest), rest)[carried],
        )

    def apply(self, animation: Animation, before: np.ndarray | None = None) -> Animation:
        """Transfer an animation of the armature that the transfer was prepared for.

        The signs of the quaternions continue those of the frame `before`, (J, 4).
        """
        sources, _ = world(animation)
        rotation = sources[:, self.sources]
        for index in np.flatnonzero(self.weights < 1):
            above = sources[:, self.above[index]] if self.above[index] >= 0 else rotations.IDENTITY
            rotation[:, index] = rotations.slerp(above, rotation[:, index], self.weights[index])
        local = np.tile(self.armature.rest, (animation.num_frames, 1, 1))
        rotated = np.empty_like(local)
        rotated[:, self.carried] = rotations.multiply(rotation, self.from_source)
        parents = np.array(self.armature.parents)
        for index in np.setdiff1d(np.arange(len(parents)), self.carried):
            above = rotated[:, parents[index]] if index else rotations.IDENTITY
            rotated[:, index] = rotations.multiply(above, local[:, index])
        backs = rotations.conjugate(rotated[:, parents[self.carried]])
        local[:, self.carried] = rotations.multiply(backs, rotated[:, self.carried])
        if 0 in self.carried:
            local[:, 0] = rotated[:, 0]
        local = rotations.continuous(rotations.unit(local), before)
        return Animation(self.armature, local, self.start + animation.translation, animation.fps, animation.meta)


def _rest_pose(armature: Armature, rig: Rig) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the rig's rest pose: (J, 3) positions, (J, 4) rotations from the T-pose, and (J, 4) orientations."""
    _, ours = rest_positions(armature)
    straight = _t_pose(armature, ours, rig)
    children = [next((i for i, joint in enumerate(rig.joints) if joint.parent == k), k) for k in range(len(rig.joints))]
    to_rest = np.tile(rotations.IDENTITY, (len(rig.joints), 1))
    at_rest = np.zeros((len(rig.joints), 3))
    for index, joint in enumerate(rig.joints):
        if joint.parent >= 0:
            to_rest[index] = to_rest[joint.parent]
        if joint.t_pose is not None:
            to_rest[index] = rotations.multiply(joint.rest, rotations.conjugate(joint.t_pose))
        elif joint.direction is not None:
            bone = rotations.rotate(to_rest[index], straight[children[index]] - straight[index])
            if np.linalg.norm(bone) > 0:
                to_rest[index] = rotations.multiply(rotations.between(bone, joint.direction), to_rest[index])
        if joint.parent < 0:
            at_rest[index] = straight[index]
        elif rig.has_own_lengths:
            at_rest[index] = at_rest[joint.parent] + joint.offset
        else:
            bone = rotations.rotate(to_rest[joint.parent], straight[index] - straight[joint.parent])
            at_rest[index] = at_rest[joint.parent] + bone
    return at_rest, to_rest, np.array([joint.rest for joint in rig.joints])


def _pelvis(armature: Armature, rig: Rig, places: np.ndarray) -> np.ndarray:
    """Return the (3,) place at rest of the rig's pelvis, 0 for an armature without pelvis."""
    if armature.joints[0] != PELVIS:
        return np.zeros(3)
    return next((places[index] for index, joint in enumerate(rig.joints) if joint.carries == PELVIS), places[0])


def _t_pose(armature: Armature, ours: np.ndarray, rig: Rig) -> np.ndarray:
    """Return (J, 3) positions of the rig's joints in the T-pose, with the motion's lengths where it has the joints."""
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
    names, parents = zip(*((joint.name, joint.parent) for joint in rig.joints), strict=True)
    above, offsets = parents[1:], np.zeros_like(at_rest)
    offsets[1:] = rotations.rotate(rotations.conjugate(rest[above, :]), at_rest[1:] - at_rest[above, :])
    return Armature(rig.name, names, parents, offsets, relative(rest, parents))
