"""Assignment of the bones of an armature to the joints of a file by name.

`bone_names.json` has for each rig of ha2g-jax, and for those of other programs, the joint that each bone takes its
rotation from, and the weight of the rotation. `build.py` writes it.
"""

import collections
import functools
import json
import pathlib
from collections.abc import Collection, Iterable, Mapping

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


def match(
    motion: Motion,
    bones: Iterable[str],
    own: Names | None = None,
    *,
    humanoid: Mapping[str, str] | None = None,
    held: Collection[str] = (),
) -> Names:
    """Assign bones to joints.

    Names are compared without case, separators, and what stands before and behind most names, such as "mixamorig:".
    Without a table of the user, the table that fits the most bones is taken, of those of the rigs and the joint names
    of the file. Joints that do not move in the whole motion are left out.

    Args:
        motion: motion with the joints.
        bones: names of the bones.
        own: table of the user, joint and weight by bone.
        humanoid: name in the VRM standard by bone, where the character's file states it.
        held: bones that do not obey their keys, because they have constraints.

    Returns:
        Joint and weight by bone.

    Raises:
        MotionError: no table fits, that of the user names an unknown joint or bone, or constraints hold a bone.
    """
    bones = list(bones)
    found = _own(motion, bones, own) if own is not None else _best(motion, bones, humanoid or {}, held)
    if stuck := sorted(set(found) & set(held)):
        what = checks.shown(f"constraints hold {len(stuck)} bones that the motion moves ({', '.join(stuck[:3])} ...)")
        raise MotionError(f"{what}; turn the constraints off, or name other bones (--names)")
    return found


def roles(motion: Motion) -> dict[str, str]:
    """Return for each joint of a motion the joint of the `ha2g` armature whose rotation it has, or its own name."""
    rig: Names = {}
    if "left_clavicle" not in motion.joints:  # as the rig ha2g has
        rig = max((_rows(table, motion.joints) for table in tables().values()), key=len)
    carried = {joint: carried for joint, (carried, weight) in rig.items() if weight == 1}
    return {joint: carried.get(joint, joint) for joint in motion.joints}


def _own(motion: Motion, bones: list[str], own: Names) -> Names:
    """Return the table of the user, whose names must be there."""
    unknown = sorted({joint for joint, _ in own.values()} - set(motion.joints))
    missing = sorted(set(own) - set(bones))
    if unknown or missing:
        what = f"the motion has no joint {unknown[0]}" if unknown else f"the armature has no bone {missing[0]}"
        raise MotionError(f"{checks.shown(what)}; give other names, or export the motion with --rig ha2g")
    return own


def _best(motion: Motion, bones: list[str], humanoid: Mapping[str, str], held: Collection[str]) -> Names:
    """Return the rows of the table that fits the most bones that are not held."""
    joints = {carried: joint for joint, carried in roles(motion).items()}
    joints |= {name: other for name, other in _OTHER_NAMES.items() if other in joints}
    moving = {joint for joint, moves in zip(motion.joints, motion.moves) if moves}
    known = {humanoid.get(bone, bone): bone for bone in bones}
    found = []
    for table in tables().values():
        rows = _rows(table, known).items()
        found.append({name: (joints[joint], weight) for name, (joint, weight) in rows if joint in joints})
    found.append(_rows({joint: (joint, 1.0) for joint in motion.joints}, known))
    found = [{known[name]: row for name, row in names.items() if row[0] in moving} for names in found]
    best = max(found, key=lambda names: len(names.keys() - set(held)))
    if len(best) < _LEAST_MATCHES:
        raise MotionError(
            f"no table of names fits the armature's bones ({checks.shown(', '.join(bones[:4]))} ...); "
            "give one as JSON, bone to joint (--names)"
        )
    return best


def _rows(table: Names, names: Iterable[str]) -> Names:
    """Return the rows of a table by those names that it knows, with what stands before and behind most of them."""
    rows = {_plain(bone): row for bone, row in table.items()}
    plain = {name: _plain(name) for name in names}
    parts = [name.partition(bone) for name in plain.values() for bone in rows]
    affixes = collections.Counter((before, behind) for before, found, behind in parts if found)
    before, behind = max(affixes, key=lambda affix: (affixes[affix], affix == ("", "")), default=("", ""))
    known = {f"{before}{bone}{behind}": row for bone, row in rows.items()}
    found = {name: known[bare] for name, bare in plain.items() if bare in known}
    # A spine with fewer bones than that of the table ends with a smaller weight.
    whole: dict[str, float] = {}
    for joint, weight in found.values():
        whole[joint] = max(weight, whole.get(joint, 0))
    return {name: (joint, weight / whole[joint]) for name, (joint, weight) in found.items()}


def _plain(name: str) -> str:
    name = name.rpartition(":")[2].lower()
    return "".join(letter for letter in name if letter not in " ._-")
