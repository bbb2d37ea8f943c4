"""Reading of any file of `ha2g export`."""

import json
import pathlib
import shutil
import struct
import subprocess
import tempfile

import numpy as np

from . import bvh, glb
from .motion import Motion, MotionError, from_local

SUFFIXES = (".glb", ".vrma", ".bvh", ".json", ".npz")


def read_motion(path: str | pathlib.Path) -> Motion:
    """Read a motion from a file.

    Args:
        path: `.glb`, `.vrma`, `.bvh` or `.json` of `ha2g export`, or, where the ha2g command is found, the `.npz` of
            `ha2g generate`.

    Returns:
        The motion.

    Raises:
        MotionError: the file is missing, or does not hold such a motion.
    """
    path = pathlib.Path(path)
    readers = {".glb": glb.read, ".vrma": glb.read, ".bvh": bvh.read, ".json": read_json, ".npz": _read_npz}
    suffix = path.suffix.lower()
    if suffix not in readers:
        raise MotionError(f"cannot read {path.name}; expected a file of ha2g export: {', '.join(SUFFIXES)}")
    if not path.is_file():
        raise MotionError(f"no motion at {path}; give a file of ha2g export")
    try:
        return readers[suffix](path)
    except (ValueError, KeyError, IndexError, TypeError, OSError, struct.error) as error:
        raise MotionError(f"{path} is not a motion ({error}); write it again with ha2g export") from error


def read_json(path: pathlib.Path) -> Motion:
    """Read the table of `ha2g export -o x.json`; its fields are described in docs/export.md.

    Args:
        path: file to read.

    Returns:
        The motion.

    Raises:
        ValueError, KeyError, TypeError: the file does not hold such a table.
    """
    table = json.loads(path.read_text(encoding="utf-8"))
    joints = table["joints"]
    return from_local(
        table["rig"],
        tuple(joint["name"] for joint in joints),
        tuple(joint["parent"] for joint in joints),
        np.array([joint["offset"] for joint in joints], float),
        np.array([joint["rest"] for joint in joints], float),
        np.array([frame["rotations"] for frame in table["frames"]], float),
        np.array([frame["positions"][0] for frame in table["frames"]], float),
        float(table["fps"]),
    )


def _read_npz(path: pathlib.Path) -> Motion:
    """Read an `.npz` with the ha2g command, because Blender's Python does not have the package."""
    command = shutil.which("ha2g")
    if command is None:
        name = path.with_suffix(".glb").name
        raise MotionError(f"no ha2g command here to read {path.name}; run: ha2g export {path.name} -o {name}")
    with tempfile.TemporaryDirectory() as folder:
        exported = pathlib.Path(folder) / f"{path.stem}.glb"
        done = subprocess.run([command, "export", str(path), "-o", str(exported)], capture_output=True, text=True)
        if done.returncode:
            said = (done.stderr.strip() or f"export of {path.name} failed").splitlines()[-1]
            raise MotionError(said.removeprefix("ha2g: "))
        return glb.read(exported)
