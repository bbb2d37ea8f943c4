"""What a file of motion holds: the first bytes tell the container, and the suffix only where they do not."""

import pathlib
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.files.npz import read_npz
from ha2g_jax.files.reading import check_regular, parse_json, read_bytes, reading, shown
from ha2g_jax.limits import MAX_MOTION_BYTES, MAX_MOTION_JSON_BYTES
from ha2g_jax.motion import motion as motions
from ha2g_jax.motion.readers import smplx_arrays
from ha2g_jax.motion.readers.named_positions import ARRAYS

SUFFIXES = (".npz", ".bvh", ".json", ".npy")
"""Suffixes by which files of motion are found in a folder."""

_EXPECTED = "a motion: .npz, .npy, .bvh or .json"
_PICKLES = (".pkl", ".pickle", ".p", ".pk")
_PICKLE = b"\x80"  # begins every pickle of protocol 2 or later
_HEAD = 64  # bytes that show the container
_MAX_GROUPS = 2_000_000  # lists of a JSON file, which take long to parse; a position of a joint is one


class Content(NamedTuple):
    """What a file of motion holds.

    Attributes:
        path: path of the file.
        container: one of `SUFFIXES`, whatever the suffix of the path.
        arrays: values by name of `.npz` and `.json`; those of other names are not read.
        array: the array of a `.npy`, empty for others.
    """

    path: pathlib.Path
    container: str
    arrays: Mapping[str, Any]
    array: np.ndarray


def read_content(path: pathlib.Path) -> Content:
    """Read the arrays of a file of motion; of a BVH nothing is read yet.

    Raises:
        UserError: the file is missing, a pickle, damaged or too large, or none of `SUFFIXES`.
    """
    check_regular(path, _EXPECTED)
    container = _container(path)
    arrays: Mapping[str, Any] = {}
    array = np.zeros(0)
    if container == ".npz":
        names = {*motions.ARRAYS, *ARRAYS, *smplx_arrays.NAMES}
        arrays = read_npz(path, max_bytes=MAX_MOTION_BYTES, names=names)
    elif container == ".npy":
        found = read_npz(path, max_bytes=MAX_MOTION_BYTES)
        if len(found) != 1:  # an archive behind other bytes
            raise UserError(f"{shown(path)} contains {len(found)} arrays; expected one, as in every .npy file")
        [array] = found.values()
    elif container == ".json":
        arrays = _read_json(path)
    return Content(path, container, arrays, array)


def _container(path: pathlib.Path) -> str:
    with reading(path, _EXPECTED), path.open("rb") as file:
        head = file.read(_HEAD)
    suffix = path.suffix.lower()
    if head.startswith(_PICKLE) or suffix in _PICKLES:
        raise UserError(
            f"{shown(path)} is a pickle, which may run code when it is read; load it where you trust it and save its "
            "arrays with numpy.savez"
        )
    text = head.removeprefix(b"\xef\xbb\xbf").lstrip()
    beginnings = {b"PK": ".npz", b"\x93NUMPY": ".npy", b"{": ".json", b"[": ".json", b"HIERARCHY": ".bvh"}
    for beginning, container in beginnings.items():
        if text.upper().startswith(beginning):
            return container
    if suffix in SUFFIXES:
        return suffix
    raise UserError(f"{shown(path)} is not a motion; expected .npz, .npy, .bvh or .json")


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
    return {name: content[name] for name in ARRAYS if name in content}
