"""Reading of any file of `ha2g export`."""

import json
import pathlib
import shutil
import struct
import subprocess
import tempfile

import numpy as np

from . import bvh, checks, glb
from .motion import Motion, MotionError, from_local

SUFFIXES = (".glb", ".vrma", ".bvh", ".json", ".npz")

_MAX_TEXT = 1 << 26  # bytes of a .bvh or .json
_MAX_GROUPS = 4_000_000  # objects and lists of a table, each of which takes a hundred bytes

# By these Python answers a tree of values of any kind where another was expected.
_UNEXPECTED = (ValueError, ArithmeticError, LookupError, TypeError, AttributeError, RecursionError, MemoryError)


def read_motion(path: str | pathlib.Path) -> Motion:
    """Read a motion from a file.

    Args:
        path: `.glb`, `.vrma`, `.bvh` or `.json` of `ha2g export`, or, where the ha2g command is found, the `.npz` of
            `ha2g generate`.

    Raises:
        MotionError: the file is missing, or does not hold such a motion.
    """
    path = pathlib.Path(path)
    readers = {".glb": glb.read, ".vrma": glb.read, ".bvh": bvh.read, ".json": read_json, ".npz": _read_npz}
    suffix = path.suffix.lower()
    if suffix not in readers:
        found = checks.shown(path.name) if path.name else "a motion without a path"
        raise MotionError(f"cannot read {found}; expected a file of ha2g export: {', '.join(SUFFIXES)}")
    try:
        if not path.is_file():
            raise MotionError(f"no motion at {checks.shown(path)}; give a file of ha2g export")
        if suffix in (".bvh", ".json") and path.stat().st_size > _MAX_TEXT:
            raise MotionError(f"{checks.shown(path)} is larger than {_MAX_TEXT >> 20} MiB; export the motion as .glb")
        return readers[suffix](path)
    except (*_UNEXPECTED, OSError, struct.error) as error:
        what = f"{checks.shown(path)} is not a motion ({checks.reason(error)})"
        raise MotionError(f"{what}; write it again with ha2g export") from error


def read_json(path: pathlib.Path) -> Motion:
    """Read the table of `ha2g export -o x.json`; its fields are described in docs/export.md.

    Raises:
        ValueError and others: the file does not hold such a table.
    """
    content = path.read_bytes()
    if content.count(b"[") + content.count(b"{") > _MAX_GROUPS:
        raise ValueError(f"more than {_MAX_GROUPS} objects and lists")
    table = json.loads(content.decode("utf-8-sig"))
    joints = table["joints"]
    checks.check_size(len(table["frames"]), len(joints))
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
        own, name = checks.shown(path.name), checks.shown(path.with_suffix(".glb").name)
        raise MotionError(f"no ha2g command here to read {own}; run: ha2g export {own} -o {name}")
    with tempfile.TemporaryDirectory() as folder:
        exported = pathlib.Path(folder) / f"{path.stem}.glb"
        arguments = [command, "export", str(path), "-o", str(exported)]
        done = subprocess.run(arguments, capture_output=True, text=True, errors="replace")
        if done.returncode:
            said = (done.stderr.strip() or f"export of {path.name} failed").splitlines()[-1]
            raise MotionError(checks.shown(said.removeprefix("ha2g: ")))
        return glb.read(exported)
