"""Rigs: the joints of other programs, each a table in `assets/rigs/`.

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
from ha2g_jax.motion import rotations
from ha2g_jax.motion.armature import Animation, Armature, ha2g_armature, world
from ha2g_jax.skeleton import load_skeleton

OWN = "ha2g"
_TABLES = importlib.resources.files("ha2g_jax") / "assets" / "rigs"
RIGS = (OWN, *sorted(file.name.removesuffix(".json") for file in _TABLES.iterdir() if file.name.endswith(".json")))

# Joints whose rotation another joint has, where the skeleton has a joint of that name for another purpose.
OTHER_NAMES = {"head": "nose_0"}


@dataclasses.dataclass(frozen=True)
class RigJoint:
    """One joint of a rig; the docstring of the module says what each field means.

    Attributes:
        name: the rig's name of the joint.
        parent: index of the parent, -1 for the root.
        carries: name of a joint of the `ha2g` armature, or None.
        place: name of a joint of the `ha2g` armature, or None.
        offset: (3,) metres.
        weight: fraction of the rotation, 0 to 1.
        rest: (4,) orientation in the world.
        t_pose: (4,) orientation in the world, or None.
        direction: (3,) unit vector in the world, or None.
    """

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
    """The joints of another program.

    Attributes:
        name: one of `RIGS`.
        has_own_lengths: whether the bones have the lengths of the rig's file; otherwise those of the motion.
        joints: all joints, each after its parent; joint 0 is the root.
    """

    name: str
    has_own_lengths: bool
    joints: tuple[RigJoint, ...]

    @property
    def names(self) -> dict[str, str]:
        """Names of the rig's joints that take all of the rotation of a `ha2g` joint, by the name of the latter."""
        return {joint.carries: joint.name for joint in self.joints if joint.carries and joint.weight == 1}


@functools.cache
def load_rig(name: str) -> Rig:
    """Load a rig.

    Args:
        name: one of `RIGS`; "ha2g" is the rig of the joints of TED-Expressive.

    Returns:
        The rig.

    Raises:
        UserError: there is no such rig.
    """
    if name == OWN:
        armature = ha2g_armature(load_skeleton("ted_expressive"))
        rows = zip(armature.joints, armature.parents, armature.offsets, strict=True)
        return Rig(OWN, False, tuple(RigJoint(joint, parent, joint, joint, offset) for joint, parent, offset in rows))
    if name not in RIGS:
        raise UserError(f"no rig {name}; expected one of {', '.join(RIGS)}")
    table = json.loads((_TABLES / f"{name}.json").read_text(encoding="utf-8"))
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
                row.get("weight", 1.0),
                **vectors,
            )
        )
        indices[row["name"]] = len(joints) - 1
    return Rig(table["name"], table["proportions"] == "table", tuple(joints))


def carriers(armature: Armature) -> dict[str, int]:
    """Return the index of the joint that rotates as each `ha2g` joint does, by the name of the latter.

    Args:
        armature: armature of any rig.
    """
    if armature.name == OWN:
        own = {name: index for index, name in enumerate(armature.joints)}
        return own | {name: own[other] for name, other in OTHER_NAMES.items() if other in own}
    return {ours: armature.joint(name) for ours, name in load_rig(armature.name).names.items()}


def places(armature: Armature) -> dict[str, int]:
    """Return the index of the joint that has the place of each `ha2g` joint, by the name of the latter.

    Args:
        armature: armature of any rig.
    """
    if armature.name == OWN:
        return {name: index for index, name in enumerate(armature.joints)}
    return {joint.place: index for index, joint in enumerate(load_rig(armature.name).joints) if joint.place}


def rest_positions(armature: Armature) -> tuple[np.ndarray, np.ndarray]:
    """Return (J, 4) orientations and (J, 3) positions in metres of an armature at rest, its root at the origin."""
    still = Animation(armature, armature.rest[None], np.zeros((1, 3)), 1.0, {})
    orientations, positions = world(still)
    return orientations[0], positions[0]
