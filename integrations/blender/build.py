"""Writes the .zip that Blender installs, and with --names first its table of bone names from the rigs of ha2g-jax.

python integrations/blender/build.py            # dist/ha2g_motion.zip, with any Python
python integrations/blender/build.py --names    # where ha2g-jax is installed, after a change of its rigs
"""

import json
import pathlib
import sys
import zipfile

FOLDER = pathlib.Path(__file__).parent
ADDON = FOLDER / "ha2g_motion"
ZIP = FOLDER.parent.parent / "dist" / "ha2g_motion.zip"
# The zip has the same bytes whenever it is made.
_DATE = (2020, 1, 1, 0, 0, 0)
_UPPER_BODY = ("spine", "head", "clavicle", "shoulder", "elbow", "wrist", "index", "middle", "ring", "pinky", "thumb")
_ARM = ("clavicle", "shoulder", "elbow", "wrist")
_FINGERS = ("thumb", "index", "middle", "ring", "pinky")

# Rigs of other programs: trunk and neck from below, with the head; the arm from the collarbone to the hand; the fingers
# from the thumb on, and the names of their three bones; the names {s} of left and right.
_OTHERS = {
    "rigify": (  # the human meta-rig
        "spine.001 spine.002 spine.003/spine.004 spine.005 spine.006",
        "shoulder.{s} upper_arm.{s} forearm.{s} hand.{s}",
        "thumb f_index f_middle f_ring f_pinky/{f}.01.{s} {f}.02.{s} {f}.03.{s}",
        "L R",
    ),
    "rigify_controls": (  # what Rigify generates from it
        "spine_fk.001 spine_fk.002 spine_fk.003/neck head",
        "shoulder.{s} upper_arm_fk.{s} forearm_fk.{s} hand_fk.{s}",
        "thumb f_index f_middle f_ring f_pinky/{f}.01.{s} {f}.02.{s} {f}.03.{s}",
        "L R",
    ),
    "humanik": (  # Mixamo's names, with a taller spine
        "Spine Spine1 Spine2 Spine3/Neck Neck1 Head",
        "{s}Shoulder {s}Arm {s}ForeArm {s}Hand",
        "Thumb Index Middle Ring Pinky/{s}Hand{f}1 {s}Hand{f}2 {s}Hand{f}3",
        "Left Right",
    ),
    "genesis8": (  # Daz Genesis 3 and 8
        "abdomenLower abdomenUpper chestLower chestUpper/neckLower neckUpper head",
        "{s}Collar {s}ShldrBend {s}ForearmBend {s}Hand",
        "Thumb Index Mid Ring Pinky/{s}{f}1 {s}{f}2 {s}{f}3",
        "l r",
    ),
    "genesis9": (
        "spine1 spine2 spine3 spine4/neck1 neck2 head",
        "{s}_shoulder {s}_upperarm {s}_forearm {s}_hand",
        "thumb index mid ring pinky/{s}_{f}1 {s}_{f}2 {s}_{f}3",
        "l r",
    ),
    "character_creator": (
        "Waist Spine01 Spine02/NeckTwist01 NeckTwist02 Head",
        "{s}_Clavicle {s}_Upperarm {s}_Forearm {s}_Hand",
        "Thumb Index Mid Ring Pinky/{s}_{f}1 {s}_{f}2 {s}_{f}3",
        "L R",
    ),
    "vroid": (
        "C_Spine C_Chest C_UpperChest/C_Neck C_Head",
        "{s}_Shoulder {s}_UpperArm {s}_LowerArm {s}_Hand",
        "Thumb Index Middle Ring Little/{s}_{f}1 {s}_{f}2 {s}_{f}3",
        "L R",
    ),
    "makehuman": (
        "spine05 spine04 spine03 spine02 spine01/neck01 neck02 neck03 head",
        "clavicle.{s} upperarm01.{s} lowerarm01.{s} wrist.{s}",
        "finger1 finger2 finger3 finger4 finger5/{f}-1.{s} {f}-2.{s} {f}-3.{s}",
        "L R",
    ),
    "biped": (  # 3ds Max; names are compared without spaces
        "Spine Spine1 Spine2 Spine3/Neck Neck1 Head",
        "{s}Clavicle {s}UpperArm {s}Forearm {s}Hand",
        "Finger0 Finger1 Finger2 Finger3 Finger4/{s}{f} {s}{f}1 {s}{f}2",
        "L R",
    ),
}


def bone_names() -> dict[str, dict[str, tuple[str, float]]]:
    """Return for each rig the joint whose rotation a bone of the upper body takes, and its weight, by bone."""
    from ha2g_jax.motion import rigs

    tables = {}
    for name in rigs.RIGS:
        rows = [joint for joint in rigs.load_rig(name).joints if _is_upper(joint.carries)]
        tables[name] = {joint.name: (str(joint.carries), joint.weight) for joint in rows}
    return tables | {name: _rows(*patterns) for name, patterns in _OTHERS.items()}


def write_bone_names() -> None:
    """Write the table with one bone on each line."""
    rigs_text = []
    for rig, rows in bone_names().items():
        lines = ",\n".join(f"    {json.dumps(bone)}: {json.dumps(row)}" for bone, row in rows.items())
        rigs_text.append(f"  {json.dumps(rig)}: {{\n{lines}\n  }}")
    (ADDON / "bone_names.json").write_text("{\n" + ",\n".join(rigs_text) + "\n}\n", encoding="utf-8")


def write_zip(path: pathlib.Path = ZIP) -> None:
    """Write the extension as an archive with its files at the top, as Blender requires."""
    files = sorted(file for file in ADDON.iterdir() if file.suffix in (".py", ".json", ".toml"))
    path.parent.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in files:
            entry = zipfile.ZipInfo(file.name, _DATE)
            entry.compress_type, entry.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
            archive.writestr(entry, file.read_bytes())


def _is_upper(joint: str | None) -> bool:
    return joint is not None and any(part in _UPPER_BODY for part in joint.split("_"))


def _rows(trunk: str, arm: str, fingers: str, sides: str) -> dict[str, tuple[str, float]]:
    """Return the joints and weights of the bones of one of `_OTHERS`."""
    rows = {}
    for joint, chain in zip(("spine", "head"), trunk.split("/")):
        bones = chain.split()
        rows |= {bone: (joint, round((index + 1) / len(bones), 4)) for index, bone in enumerate(bones)}
    names, parts = (text.split() for text in fingers.split("/"))
    for side, own in zip(("left", "right"), sides.split()):
        bones = arm.format(s=own).split()
        rows |= {bone: (f"{side}_{joint}", 1.0) for bone, joint in zip(bones, _ARM)}
        for finger, name in zip(_FINGERS, names):
            bones = [part.format(s=own, f=name) for part in parts]
            rows |= {bone: (f"{side}_{finger}_{index}", 1.0) for index, bone in enumerate(bones, 1)}
    return rows


if __name__ == "__main__":
    if "--names" in sys.argv[1:]:
        write_bone_names()
    write_zip()
    print(ZIP)
