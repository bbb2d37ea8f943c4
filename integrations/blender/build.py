"""Writes the table of bone names of the add-on from the rigs of ha2g-jax, and the .zip that Blender installs.

python integrations/blender/build.py            # the table, and dist/ha2g_motion.zip
"""

import json
import pathlib
import zipfile

from ha2g_jax.motion import rigs

FOLDER = pathlib.Path(__file__).parent
ADDON = FOLDER / "ha2g_motion"
ZIP = FOLDER.parent.parent / "dist" / "ha2g_motion.zip"
# The zip has the same bytes whenever it is made.
_DATE = (2020, 1, 1, 0, 0, 0)
_UPPER_BODY = ("spine", "head", "clavicle", "shoulder", "elbow", "wrist", "index", "middle", "ring", "pinky", "thumb")
_FINGERS = {"thumb": "thumb", "index": "f_index", "middle": "f_middle", "ring": "f_ring", "pinky": "f_pinky"}


def bone_names() -> dict[str, dict[str, tuple[str, float]]]:
    """Return for each rig the joint whose rotation a bone of the upper body takes, and its weight, by bone."""
    tables = {}
    for name in rigs.RIGS:
        if name == rigs.OWN:  # has the names of the joints
            continue
        rows = [joint for joint in rigs.load_rig(name).joints if _is_upper(joint.carries)]
        tables[name] = {joint.name: (str(joint.carries), joint.weight) for joint in rows}
    return tables | {"rigify": _rigify()}


def write_bone_names(path: pathlib.Path = ADDON / "bone_names.json") -> None:
    """Write the table with one bone on each line.

    Args:
        path: JSON file to write.
    """
    rigs_text = []
    for rig, rows in bone_names().items():
        lines = ",\n".join(f"    {json.dumps(bone)}: {json.dumps(row)}" for bone, row in rows.items())
        rigs_text.append(f"  {json.dumps(rig)}: {{\n{lines}\n  }}")
    path.write_text("{\n" + ",\n".join(rigs_text) + "\n}\n", encoding="utf-8")


def write_zip(path: pathlib.Path = ZIP) -> None:
    """Write the extension as an archive with its files at the top, as Blender requires.

    Args:
        path: zip file to write.
    """
    files = sorted(file for file in ADDON.iterdir() if file.suffix in (".py", ".json", ".toml"))
    path.parent.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in files:
            entry = zipfile.ZipInfo(file.name, _DATE)
            entry.compress_type, entry.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
            archive.writestr(entry, file.read_bytes())


def _is_upper(joint: str | None) -> bool:
    return joint is not None and any(part in _UPPER_BODY for part in joint.split("_"))


def _rigify() -> dict[str, tuple[str, float]]:
    """Return the joints and weights of the bones of Rigify's human meta-rig, which comes with Blender."""
    rows = {"spine.001": ("spine", 0.3333), "spine.002": ("spine", 0.6667), "spine.003": ("spine", 1.0)}
    rows |= {"spine.004": ("head", 0.3333), "spine.005": ("head", 0.6667), "spine.006": ("head", 1.0)}
    for side, letter in (("left", "L"), ("right", "R")):
        arm = {"shoulder": "clavicle", "upper_arm": "shoulder", "forearm": "elbow", "hand": "wrist"}
        rows |= {f"{bone}.{letter}": (f"{side}_{joint}", 1.0) for bone, joint in arm.items()}
        for finger, bone in _FINGERS.items():
            rows |= {f"{bone}.0{part}.{letter}": (f"{side}_{finger}_{part}", 1.0) for part in (1, 2, 3)}
    return rows


if __name__ == "__main__":
    write_bone_names()
    write_zip()
