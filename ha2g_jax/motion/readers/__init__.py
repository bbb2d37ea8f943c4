"""Reading of motion of any system as a `Motion`, whatever the file: the kind is found by its content.

| kind | file |
|---|---|
| own | `.npz` that `ha2g generate` or `Motion.save` wrote |
| BVH | `.bvh` of any skeleton that a joint map knows |
| SMPL-X | `.npz` in the layouts of `motion.readers.smplx_arrays`, `.npy` of joint positions |
| directions | `.npy` of direction vectors (T, 126), (T, 42, 3), (T, 27), (T, 9, 3), whole or less the mean |
| positions | `.npz` or `.json` with `positions` (T, J, 3), `fps` and `joint_names`; `.npy` (T, 43, 3) or (T, 10, 3) |

Nothing is unpickled, and sizes are checked before anything is unpacked.
"""

import dataclasses
import os
import pathlib
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.files.npz import read_npz
from ha2g_jax.files.reading import check_regular, naming, parse_json, read_bytes, reading, reason, shown
from ha2g_jax.limits import MAX_MOTION_BYTES, MAX_MOTION_FPS, MAX_MOTION_JSON_BYTES, MIN_MOTION_FPS
from ha2g_jax.motion import motion as motions
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.readers import array_files, bvh_motion, joint_maps, smplx, smplx_arrays
from ha2g_jax.motion.readers.body import ARM_RANGE, arm_length
from ha2g_jax.motion.readers.bvh import read_bvh
from ha2g_jax.motion.readers.smplx_body import template
from ha2g_jax.motion.resample import num_frames, resample
from ha2g_jax.skeleton import SKELETONS, load_skeleton

__all__ = ["SUFFIXES", "borders_of", "read_motion"]

SUFFIXES = (".npz", ".bvh", ".json", ".npy")
"""Suffixes by which files of motion are found in a folder."""

_EXPECTED = "a motion: .npz, .npy, .bvh or .json"
_PICKLES = (".pkl", ".pickle", ".p", ".pk")
_PICKLE = b"\x80"  # begins every pickle of protocol 2 or later
_BEGINNINGS = {b"PK": ".npz", b"\x93NUMPY": ".npy", b"{": ".json", b"[": ".json", b"HIERARCHY": ".bvh"}
_HEAD = 64  # bytes that show the container
_MAX_GROUPS = 2_000_000  # lists of a JSON file, which take long to parse; a position of a joint is one


def read_motion(
    path: str | os.PathLike,
    *,
    skeleton: str | None = None,
    fps: float | None = None,
    source_fps: float | None = None,
    joint_map: str = joint_maps.AUTO,
) -> Motion:
    """Read the motion of a file of any kind.

    Args:
        skeleton: skeleton of the result, "ted_expressive" or "ted_gesture"; by default the first that the file fits.
        fps: frames per second of the result; None keeps those of the file. A motion of our own keeps its rate.
        source_fps: frames per second of a file that does not say it; direction vectors have 15 by default.
        joint_map: names of the joints in the file: "auto", one of `joint_maps.MAPS` or the path of a JSON or YAML file.

    Returns:
        The motion; `meta["read_from"]` says of a third-party file how it was read: "kind", "fps" of the file and more.

    Raises:
        UserError: the file cannot be read, is of no kind, or does not hold a motion.
    """
    path = pathlib.Path(path)
    if source_fps is not None and not MIN_MOTION_FPS <= source_fps <= MAX_MOTION_FPS:
        raise UserError(f"{source_fps:g} frames per second of the file; expected {MIN_MOTION_FPS} to {MAX_MOTION_FPS}")
    content = read_content(path)
    motion = _reader_of(content)(content, _Options(skeleton, fps, source_fps, joint_map))
    with naming(path):
        motion.check()
    return motion


def borders_of(motion: Motion, path: pathlib.Path) -> tuple[int, ...]:
    """Return the first frames of the windows that a motion was joined from; others than frames are a UserError."""
    try:
        return tuple(array_files.read_borders(motion.meta, motion.num_frames).tolist())
    except (ValueError, TypeError, OverflowError) as error:
        raise UserError(
            f"{shown(path)} has borders that are not frames ({reason(error)}); generate the motion again"
        ) from error


class Content(NamedTuple):
    """What a file of motion holds.

    Attributes:
        container: one of `SUFFIXES`, whatever the suffix of the path.
        arrays: values by name of `.npz` and `.json`; those of other names are not read.
        array: the array of a `.npy`, empty for others.
    """

    path: pathlib.Path
    container: str
    arrays: Mapping[str, Any]
    array: np.ndarray


class _Options(NamedTuple):
    """The options of `read_motion`."""

    skeleton: str | None
    fps: float | None
    source_fps: float | None
    joint_map: str


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


def _container(path: pathlib.Path) -> str:
    """Return the suffix that the first bytes of a file stand for, or its own where they do not tell."""
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
    return {name: content[name] for name in array_files.ARRAYS if name in content}


def _reader_of(content: Content) -> Callable[[Content, _Options], Motion]:
    """Choose the reader of a file by its content; the last one takes what is left, and says what it lacks."""
    if "directions" in content.arrays and "meta" in content.arrays:
        return _read_own
    if content.container == ".bvh":
        return _read_bvh
    if _is_smplx(content):
        return _read_smplx
    return _read_array if content.container == ".npy" else _read_positions


def _check_skeleton(path: pathlib.Path, found: str, options: _Options) -> None:
    if options.skeleton not in (None, found):
        raise UserError(
            f"{shown(path)} has the skeleton {found}, not {options.skeleton} as the others; give motion of one "
            "skeleton at a time"
        )


def _read_own(content: Content, options: _Options) -> Motion:
    motion = Motion.from_arrays(content.arrays, content.path)
    _check_skeleton(content.path, motion.meta["skeleton"], options)
    if "borders" in content.arrays:
        motion = dataclasses.replace(motion, meta=motion.meta | {"borders": content.arrays["borders"]})
        motion.meta["borders"] = list(borders_of(motion, content.path))
    return motion


def _read_bvh(content: Content, options: _Options) -> Motion:
    skeleton = load_skeleton(options.skeleton or _bvh_skeleton(content.path, options.joint_map))
    found = bvh_motion.read_motion(content.path, skeleton, fps=options.fps, joint_map=options.joint_map, with_legs=True)
    array_files.check_positions(found.positions.astype(np.float64), skeleton, content.path)
    facts = {"kind": "BVH", "fps": found.fps, "joint_map": found.joint_map, "unit": found.unit, "up": found.up}
    fps = options.fps or found.fps
    return Motion.from_positions(skeleton, found.positions, fps, {"read_from": facts}, lower=found.lower)


def _bvh_skeleton(path: pathlib.Path, joint_map: str) -> str:
    joints = read_bvh(path).joints
    for name in SKELETONS[:-1]:
        try:
            joint_maps.choose_map(joints, load_skeleton(name), joint_map, path)
        except UserError:
            continue
        return name
    return SKELETONS[-1]  # the error at reading then says what is missing


def _is_smplx(content: Content) -> bool:
    arrays = content.arrays
    if smplx_arrays.has_poses(arrays):
        return True
    if "joint_names" in arrays:
        return False
    found = [arrays[name] for name in smplx_arrays.POSITIONS if name in arrays] or [content.array]
    return isinstance(found[0], np.ndarray) and found[0].ndim == 3 and found[0].shape[1] in smplx_arrays.NUM_POSITIONS


def _read_smplx(content: Content, options: _Options) -> Motion:
    skeleton = load_skeleton(options.skeleton or SKELETONS[0])
    arrays = content.arrays or {smplx_arrays.POSITIONS[0]: content.array}
    with naming(content.path):
        found = smplx.to_motion(
            smplx_arrays.to_arrays(arrays, options.source_fps), skeleton, template(), fps=options.fps
        )
    array_files.check_positions(found.positions.astype(np.float64), skeleton, content.path)
    meta = {"read_from": {"kind": "SMPL-X", "fps": found.fps, "up": found.up}}
    fps = options.fps or found.fps
    return Motion.from_positions(skeleton, found.positions, fps, meta, lower=found.lower, face=found.face)


def _read_positions(content: Content, options: _Options) -> Motion:
    return _from_positions(array_files.read_arrays(content.arrays, content.path), content.path, options)


def _from_positions(arrays: array_files.Arrays, path: pathlib.Path, options: _Options) -> Motion:
    skeleton = load_skeleton(options.skeleton or array_files.find_skeleton(arrays, options.joint_map, path))
    positions = array_files.in_skeleton(arrays, skeleton, options.joint_map, path)
    meta: dict[str, Any] = {"read_from": {"kind": "positions", "fps": arrays.fps}}
    if len(arrays.borders):
        meta["borders"] = arrays.borders.tolist()
    motion = Motion.from_positions(skeleton, positions, arrays.fps, meta)
    length = arm_length(positions, skeleton, "left")
    if not ARM_RANGE[0] <= length <= ARM_RANGE[1]:  # not in metres: take the skeleton's bones
        motion = Motion.from_directions(skeleton, motion.directions, arrays.fps, motion.meta)
    return _at_rate(motion, options.fps)


def _read_array(content: Content, options: _Options) -> Motion:
    """Read a `.npy` of direction vectors, or of the positions of all joints of a skeleton."""
    array, fps = content.array, options.source_fps or array_files.FPS
    if name := array_files.directions_skeleton(array):
        _check_skeleton(content.path, name, options)
        skeleton = load_skeleton(name)
        directions, is_residual = array_files.read_directions(array, skeleton, content.path)
        facts = {"kind": "directions", "fps": fps, "mean_was_subtracted": is_residual}
        return _at_rate(Motion.from_directions(skeleton, directions, fps, {"read_from": facts}), options.fps)
    for name in SKELETONS:
        joints = load_skeleton(name).joints
        if array.size and array.shape[1:] == (len(joints), 3):
            _check_skeleton(content.path, name, options)
            arrays = {"positions": array, "fps": np.array(fps), "joint_names": np.array(joints)}
            return _from_positions(array_files.read_arrays(arrays, content.path), content.path, options)
    raise UserError(
        f"{shown(content.path)} holds an array of shape {array.shape}; expected directions (T, 126), (T, 42, 3), "
        "(T, 27) or (T, 9, 3), positions (T, 43, 3) or (T, 10, 3), or joints of SMPL-X (T, 55, 3)"
    )


def _at_rate(motion: Motion, fps: float | None) -> Motion:
    """Resample a motion on the sphere; its bones take the mean lengths of the motion."""
    if fps is None or fps == motion.fps:
        return motion
    count = num_frames(motion.num_frames / motion.fps, fps)
    meta = dict(motion.meta)
    if "borders" in meta:
        meta["borders"] = sorted({round(border * fps / motion.fps) for border in meta["borders"]})
    directions = resample(motion.directions, motion.fps, fps, count)
    return Motion.from_directions(motion.skeleton, directions, fps, meta)
