"""Files of motion by their container: what a file is, whatever its suffix, and the arrays that it holds."""

import pathlib
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.files.npz import read_npz
from ha2g_jax.files.reading import check_regular, parse_json, read_bytes, reading, shown
from ha2g_jax.limits import MAX_MOTION_BYTES, MAX_MOTION_JSON_BYTES
from ha2g_jax.motion import motion as motions
from ha2g_jax.motion.readers import array_files, smplx_arrays, trees

SUFFIXES = (".npz", ".bvh", ".glb", ".vrma", ".json", ".csv", ".npy")
"""Suffixes by which files of motion are found in a folder."""

_KINDS = ".npz, .npy, .bvh, .glb, .vrma, .json or .csv"
_EXPECTED = f"a motion: {_KINDS}"
_PICKLES = (".pkl", ".pickle", ".p", ".pk")
_PICKLE = b"\x80"  # begins every pickle of protocol 2 or later
_BEGINNINGS = {
    **{b"PK": ".npz", b"\x93NUMPY": ".npy", b"{": ".json", b"[": ".json", b"HIERARCHY": ".bvh"},
    b"GLTF": ".glb",
}
_HEAD = 64  # bytes that show the container
_MAX_GROUPS = 2_000_000  # lists of a JSON file, which take long to parse; a position of a joint is one


def is_motion(path: pathlib.Path) -> bool:
    """Return whether a file in a folder is motion by its name, and a `.csv`, which may hold words, by its content."""
    suffix = path.suffix.lower()
    return suffix in SUFFIXES and path.is_file() and (suffix != ".csv" or trees.is_csv(path))


class Content(NamedTuple):
    """What a file of motion holds.

    Attributes:
        container: one of `SUFFIXES`, ".glb" for `.vrma` as well, whatever the suffix of the path.
        arrays: values by name of `.npz` and `.json`; those of other names are not read.
        array: the array of a `.npy`, empty for others.
    """

    path: pathlib.Path
    container: str
    arrays: Mapping[str, Any]
    array: np.ndarray


def read_content(path: pathlib.Path) -> Content:
    """Read the arrays of a file of motion; of a tree of joints, such as BVH, nothing is read yet.

    Raises:
        UserError: the file is missing, a pickle, damaged or too large, or none of `SUFFIXES`.
    """
    check_regular(path, _EXPECTED)
    container = container_of(path)
    arrays: Mapping[str, Any] = {}
    array = np.zeros(0)
    if container == ".npz":
        names = {*motions.ARRAYS, *array_files.ARRAYS, *smplx_arrays.NAMES}
        arrays = read_npz(path, max_bytes=MAX_MOTION_BYTES, names=names)
    elif container == ".npy":
        found = read_npz(path, max_bytes=MAX_MOTION_BYTES)
        if len(found) != 1:  # an archive behind other bytes
            raise UserError(f"{shown(path)} contains {len(found)} arrays; expected one, as in every .npy file")
        [array] = found.values()
    elif container == ".json":
        arrays = _read_json(path)
    return Content(path, container, arrays, array)


def container_of(path: pathlib.Path) -> str:
    """Return the suffix of `SUFFIXES` that the first bytes of a file stand for, or its own where they do not tell.

    Raises:
        UserError: the file cannot be read, is a pickle, or none of `SUFFIXES`.
    """
    with reading(path, _EXPECTED), path.open("rb") as file:
        head = file.read(_HEAD)
    suffix = path.suffix.lower()
    if head.startswith(_PICKLE) or suffix in _PICKLES:
        raise UserError(
            f"{shown(path)} is a pickle, which may run code when it is read; load it where you trust it and save its "
            "arrays with numpy.savez"
        )
    text = head.removeprefix(b"\xef\xbb\xbf").lstrip().upper()
    for beginning, container in _BEGINNINGS.items():
        if text.startswith(beginning):
            return container
    if trees.is_csv(path):
        return ".csv"
    if suffix in SUFFIXES:
        return ".glb" if suffix == ".vrma" else suffix
    raise UserError(f"{shown(path)} is not a motion; expected {_KINDS}")


def _read_json(path: pathlib.Path) -> Mapping[str, Any]:
    text = read_bytes(path, "a motion in JSON", MAX_MOTION_JSON_BYTES)
    if text.count(b"[") + text.count(b"{") > _MAX_GROUPS:
        raise UserError(f"{shown(path)} has more than {_MAX_GROUPS} lists; give it as .npz, or cut the motion")
    with reading(path, "a motion in JSON"):
        content = parse_json(text)
    if not isinstance(content, dict):
        raise UserError(
            f"{shown(path)} holds no motion but a {type(content).__name__}; expected positions (T, J, 3), fps and "
            "joint_names (J,)"
        )
    if "asset" in content:
        raise UserError(f"{shown(path)} is glTF as text (.gltf); export it as .glb")
    return {name: content[name] for name in (*array_files.ARRAYS, *trees.TABLE) if name in content}
