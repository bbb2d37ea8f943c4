"""Assignment of the bones of an armature to the joints of a file by name.

`bone_names.json` has for each rig of ha2g-jax, and for Rigify's human, the joint that each bone takes its rotation
from, and the weight of the rotation. `build.py` writes it.
"""

import functools
import json
import pathlib
from collections.abc import Iterable

from . import checks
from .motion import Motion, MotionError

Names = dict[str, tuple[str, float]]

_MAX_BYTES = 1 << 20
_LEAST_MATCHES = 4  # bones of both arms; fewer may be equal by chance
# Where a skeleton has another joint named head, this joint rotates the head.
_OTHER_NAMES = {"head": "nose_0"}


@functools.cache
def tables() -> dict[str, Names]:
    """Return for each rig the joint of the `ha2g` armature that a bone carries, and its weight, by bone."""
    rigs = json.loads((pathlib.Path(__file__).parent / "bone_names.json").read_text(encoding="utf-8"))
    return {rig: {bone: (joint, weight) for bone, (joint, weight) in rows.items()} for rig, rows in rigs.items()}


def read_names(path: str | pathlib.Path) -> Names:
    """Read a table of the user, a JSON object {"BONE": "JOINT"} or {"BONE": ["JOINT", WEIGHT]}.

    Args:
        path: JSON file to read.

    Returns:
        Joint and weight by bone.

    Raises:
        MotionError: the file is missing or does not hold such a table.
    """
    try:
        rows = json.loads(checks.read_bytes(pathlib.Path(path), _MAX_BYTES).decode("utf-8-sig"))
        pairs = {bone: (value, 1.0) if isinstance(value, str) else value for bone, value in rows.items()}
        return {bone: (str(joint), _weight(weight)) for bone, (joint, weight) in pairs.items()}
    except (OSError, ValueError, ArithmeticError, TypeError, AttributeError, RecursionError) as error:
        raise MotionError(
            f"{checks.shown(path)} is not a table of names ({checks.reason(error)}); write a JSON object "
            '{"BONE": "JOINT"}'
        ) from error


def _weight(value: float) -> float:
    if not 0 <= float(value) <= 1:
        raise ValueError("a weight that is not from 0 to 1")
    return float(value)


def match(motion: Motion, bones: Iterable[str], own: Names | None = None) -> Names:
    """Assign bones to joints.

    Names are compared without case, prefix (such as "mixamorig:") and separators. Without a table of the user, the
    table that fits the most bones is taken, of those of the rigs and the joint names of the file. Joints that do not
    move in the whole motion are left out.

    Args:
        motion: motion with the joints.
        bones: names of the bones.
        own: table of the user, joint and weight by bone.

    Returns:
        Joint and weight by bone.

    Raises:
        MotionError: no table fits, or that of the user names an unknown joint or bone.
    """
    bones = list(bones)
    joints = {joint: joint for joint in motion.joints}
    moving = {joint for joint, moves in zip(motion.joints, motion.moves) if moves}
    if own is not None:
        unknown = sorted({joint for joint, _ in own.values()} - set(joints))
        missing = sorted(set(own) - set(bones))
        if unknown or missing:
            what = f"the motion has no joint {unknown[0]}" if unknown else f"the armature has no bone {missing[0]}"
            what = checks.shown(what)
            raise MotionError(f"{what}; give other names, or export the motion with --rig ha2g")
        return own
    joints |= {name: other for name, other in _OTHER_NAMES.items() if other in joints}
    found: list[Names] = []
    for table in ({joint: (joint, 1.0) for joint in motion.joints}, *tables().values()):
        rows = {_plain(bone): (joints[joint], weight) for bone, (joint, weight) in table.items() if joint in joints}
        found.append({bone: rows[_plain(bone)] for bone in bones if _plain(bone) in rows})
    best = max(({bone: row for bone, row in names.items() if row[0] in moving} for names in found), key=len)
    if len(best) < _LEAST_MATCHES:
        raise MotionError(
            f"no table of names fits the armature's bones ({checks.shown(', '.join(bones[:4]))} ...); "
            "give one as JSON, bone to joint (--names)"
        )
    return best


def role(motion: Motion, joint: str) -> str:
    """Return the joint of the `ha2g` armature whose rotation a joint of the motion has, or its own name.

    Args:
        motion: motion with the joint.
        joint: name of the joint.
    """
    if "left_clavicle" in motion.joints:  # the rig ha2g
        return joint
    rig = max(tables().values(), key=lambda table: len(table.keys() & set(motion.joints)))
    carried, weight = rig.get(joint, (joint, 1.0))
    return carried if weight == 1 else joint


def _plain(name: str) -> str:
    name = name.rpartition(":")[2].lower()
    return "".join(letter for letter in name if letter not in " ._-")
