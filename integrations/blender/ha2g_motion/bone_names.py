"""Which bone of an armature turns as which joint of a file, by name.

`bone_names.json` has for each rig of ha2g-jax, and for Rigify's human, the joint that each bone takes its rotation
from, and what share of it; `build.py` writes it.
"""

import functools
import json
import pathlib
from collections.abc import Iterable

from .motion import Motion, MotionError

Names = dict[str, tuple[str, float]]

_LEAST_MATCHES = 4  # both arms: fewer are a chance
# Where a skeleton has a joint named head, another turns it.
_OTHER_NAMES = {"head": "nose_0"}


@functools.cache
def tables() -> dict[str, Names]:
    """Return for each rig, by bone: the joint of the `ha2g` armature that it carries, and the share of its rotation."""
    rigs = json.loads((pathlib.Path(__file__).parent / "bone_names.json").read_text(encoding="utf-8"))
    return {rig: {bone: (joint, share) for bone, (joint, share) in rows.items()} for rig, rows in rigs.items()}


def read_names(path: str | pathlib.Path) -> Names:
    """Read one's own table, a JSON object {"BONE": "JOINT"} or {"BONE": ["JOINT", SHARE]}.

    Raises:
        MotionError: no such file, or not such a table.
    """
    try:
        rows = json.loads(pathlib.Path(path).read_text(encoding="utf-8"))
        pairs = {bone: (value, 1.0) if isinstance(value, str) else value for bone, value in rows.items()}
        return {bone: (str(joint), float(share)) for bone, (joint, share) in pairs.items()}
    except (OSError, ValueError, TypeError, AttributeError) as error:
        raise MotionError(f'{path} is no table of names ({error}); write a JSON object {{"BONE": "JOINT"}}') from error


def match(motion: Motion, bones: Iterable[str], own: Names | None = None) -> Names:
    """Return the joint that each bone takes its rotation from, and the share of it.

    Names count as equal whatever their case, prefix (as "mixamorig:") and separators. Without a table of one's own,
    that of the rigs, or the file's joint names themselves, is taken which fits the most bones. Joints that stand still
    for the whole motion are left to whoever else moves them.

    Raises:
        MotionError: no table fits, or one's own names a joint that the motion has not.
    """
    bones = list(bones)
    joints = {joint: joint for joint in motion.joints}
    moving = {joint for joint, moves in zip(motion.joints, motion.moves) if moves}
    if own is not None:
        unknown = sorted({joint for joint, _ in own.values()} - set(joints))
        missing = sorted(set(own) - set(bones))
        if unknown or missing:
            what = f"the motion has no joint {unknown[0]}" if unknown else f"the armature has no bone {missing[0]}"
            raise MotionError(f"{what}; give other names, or export the motion with --rig ha2g")
        return own
    joints |= {name: other for name, other in _OTHER_NAMES.items() if other in joints}
    found: list[Names] = []
    for table in ({joint: (joint, 1.0) for joint in motion.joints}, *tables().values()):
        rows = {_plain(bone): (joints[joint], share) for bone, (joint, share) in table.items() if joint in joints}
        found.append({bone: rows[_plain(bone)] for bone in bones if _plain(bone) in rows})
    best = max(({bone: row for bone, row in names.items() if row[0] in moving} for names in found), key=len)
    if len(best) < _LEAST_MATCHES:
        raise MotionError(
            f"no table of names fits the armature's bones ({', '.join(bones[:4])} ...); "
            "give one as JSON, bone to joint (--names)"
        )
    return best


def role(motion: Motion, joint: str) -> str:
    """Return the joint of the `ha2g` armature that a joint of the motion turns as, or its own name."""
    if "left_clavicle" in motion.joints:  # the rig ha2g
        return joint
    rig = max(tables().values(), key=lambda table: len(table.keys() & set(motion.joints)))
    carried, share = rig.get(joint, (joint, 1.0))
    return carried if share == 1 else joint


def _plain(name: str) -> str:
    name = name.rpartition(":")[2].lower()
    return "".join(letter for letter in name if letter not in " ._-")
