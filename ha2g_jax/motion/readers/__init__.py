"""Reading of motion of any system as a `Motion`; the kind of a file is recognised by its content.

| kind | file |
|---|---|
| own | `.npz` that `ha2g generate` or `Motion.save` wrote |
| BVH | `.bvh` of any skeleton that a joint map knows |
| glTF | `.glb` or `.vrma` of such a skeleton, with one animation |
| SMPL-X | `.npz` in the layouts of `motion.readers.smplx_arrays`, `.npy` of joint positions |
| directions | `.npy` of direction vectors (T, 126), (T, 42, 3), (T, 27), (T, 9, 3), whole or less the mean |
| table | `.json` or `.csv` of any rig that `ha2g export` wrote |
| positions | `.npz` or `.json` with `positions` (T, J, 3), `fps` and `joint_names`; `.npy` (T, 43, 3) or (T, 10, 3) |

Nothing is unpickled, and sizes are checked before anything is unpacked.
"""

import dataclasses
import logging
import os
import pathlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, TypedDict, Unpack

import numpy as np
from scipy.spatial.transform import Rotation

from ha2g_jax.errors import UserError, check_number
from ha2g_jax.files.reading import naming, reason, shown
from ha2g_jax.limits import MAX_MOTION_FPS, MIN_MOTION_FPS
from ha2g_jax.motion.armature import export_axes, world
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.readers import array_files, bvh_motion, joint_maps, smplx, smplx_arrays, trees
from ha2g_jax.motion.readers.body import ARM_RANGE, FACE, add_rest_face, arm_length, check_arms, check_stated
from ha2g_jax.motion.readers.bvh import Bvh
from ha2g_jax.motion.readers.containers import SUFFIXES, Content, is_motion, read_content
from ha2g_jax.motion.readers.smplx_body import template
from ha2g_jax.motion.resample import num_frames, resample
from ha2g_jax.motion.solver import animate
from ha2g_jax.skeleton import SKELETONS, hand_joints, load_skeleton

__all__ = ["SUFFIXES", "Reading", "at_rate", "borders_of", "check_reading", "is_motion", "read_motion"]

_logger = logging.getLogger(__name__)

_TREES = {".bvh": "BVH", ".glb": "glTF", ".json": "table", ".csv": "table"}  # kinds by container
_FACTS = ("fps", "joint_map", "unit", "up")  # facts about the motion of a tree that are stored in `meta`


class Reading(TypedDict, total=False):
    """What a user states about third-party files of motion: keyword arguments of `read_motion`.

    Attributes:
        joint_map: names of the joints in the file: "auto", one of `joint_maps.MAPS` or the path of a JSON or YAML file.
        source_fps: frames per second of the file, whatever it says; by default what it says, and 15 for bare arrays.
        unit: metres in one unit of the file; by default found by the arms' length.
    """

    joint_map: str
    source_fps: float | None
    unit: float | None


def check_reading(paths: Sequence[pathlib.Path], **reading: Unpack[Reading]) -> None:
    """Raise a UserError if an option has an effect on none of the files, or one of the files cannot be read."""
    given = {name: value for name, value in reading.items() if value not in (None, joint_maps.AUTO)}
    for path in paths if given else ():
        effects = _EFFECTS[_reader_of(read_content(path))]
        given = {name: value for name, value in given.items() if name not in effects}
        if not given:
            return
    if given:
        options = ", ".join(f"--{name.replace('_', '-')}" for name in given)
        files = f"{shown(paths[0])} and the others" if paths[1:] else shown(paths[0])
        raise UserError(f"the motion of {files} does not depend on {options}; leave {options} out")


def read_motion(
    path: str | os.PathLike,
    *,
    skeleton: str | None = None,
    fps: float | None = None,
    **reading: Unpack[Reading],
) -> Motion:
    """Read the motion of a file of any kind.

    Args:
        skeleton: skeleton of the result, "ted_expressive" or "ted_gesture"; by default the first that the file fits.
        fps: frames per second of the result; None keeps those of the file. A motion of our own keeps its rate.
        reading: what is known about the file, see `Reading`; options that its kind does not use have no effect.

    Returns:
        The motion; for a third-party file `meta["read_from"]` says how it was read: "kind", "fps" of the file and more.

    Raises:
        UserError: the file cannot be read, is of an unknown kind, holds no motion, or lacks joints of the skeleton; or
            there is no such skeleton, or the rate is out of range.
    """
    if skeleton not in (None, *SKELETONS):
        raise UserError(f"no skeleton {skeleton!r}; expected {' or '.join(SKELETONS)}")
    path = pathlib.Path(path)
    options = _Options(skeleton, fps, **reading)
    check_stated(options.source_fps, options.unit)
    if fps is not None:
        message = f"{fps} frames per second of the result; expected {MIN_MOTION_FPS} to {MAX_MOTION_FPS}"
        check_number(fps, MIN_MOTION_FPS, MAX_MOTION_FPS, message)
    content = read_content(path)
    motion = _reader_of(content)(content, options)
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


class _Options(NamedTuple):
    """The options of `read_motion`."""

    skeleton: str | None
    fps: float | None
    joint_map: str = joint_maps.AUTO
    source_fps: float | None = None
    unit: float | None = None


def _reader_of(content: Content) -> Callable[[Content, _Options], Motion]:
    """Choose the reader of a file by its content; the last one takes all other files and reports what is missing."""
    if "directions" in content.arrays and "meta" in content.arrays:
        return _read_own
    if content.container in _TREES and (content.container != ".json" or "frames" in content.arrays):
        return _read_tree
    if _is_smplx(content):
        return _read_smplx
    if content.container == ".npy":
        return _read_directions if array_files.directions_skeleton(content.array) else _read_array
    return _read_positions


def _in_skeleton(motion: Motion, path: pathlib.Path, options: _Options) -> Motion:
    """Return a motion on the requested skeleton; fingers that this lacks are left out.

    Raises:
        UserError: the skeleton has fingers, and the motion has none.
    """
    found = motion.meta["skeleton"]
    if options.skeleton in (None, found):
        return motion
    skeleton = load_skeleton(options.skeleton)
    if skeleton.name == SKELETONS[0]:
        raise UserError(
            f"{shown(path)} has the skeleton {found}, not {skeleton.name} as the others; give motion of one "
            "skeleton at a time"
        )
    with naming(path):
        animation = animate(dataclasses.replace(motion, lower=None))
    turned, _ = world(animation)
    body = [joint for joint in skeleton.joints if joint not in FACE]
    positions = np.zeros((motion.num_frames, skeleton.num_joints, 3))
    positions[:, [*map(skeleton.joint, body)]] = motion.positions[:, [*map(motion.joint_names.index, body)]]
    positions *= export_axes(load_skeleton(found))
    head = Rotation.from_quat(turned[:, animation.armature.joint(joint_maps.HEAD)]).as_matrix()
    positions = add_rest_face(positions, head, skeleton) * export_axes(skeleton)
    meta = {name: value for name, value in motion.meta.items() if name not in ("skeleton", "axes")}
    return Motion.from_positions(skeleton, positions, motion.fps, meta, lower=motion.lower, face=motion.face)


def _read_own(content: Content, options: _Options) -> Motion:
    motion = _in_skeleton(Motion.from_arrays(content.arrays, content.path), content.path, options)
    if "borders" in content.arrays:
        motion = dataclasses.replace(motion, meta=motion.meta | {"borders": content.arrays["borders"]})
        motion.meta["borders"] = list(borders_of(motion, content.path))
    return motion


def _read_tree(content: Content, options: _Options) -> Motion:
    given = {"fps": options.fps, "unit": options.unit}
    if content.container == ".json":
        bvh = trees.read_json(_stated(content, options), content.path)
    else:
        bvh = bvh_motion.read_tree(content.path, options.source_fps)
    skeleton = load_skeleton(options.skeleton or _bvh_skeleton(bvh, content.path, options.joint_map))
    found = bvh_motion.to_motion(bvh, content.path, skeleton, joint_map=options.joint_map, with_legs=True, **given)
    array_files.check_positions(found.positions.astype(np.float64), skeleton, content.path)
    facts = {"kind": _TREES[content.container]} | {name: getattr(found, name) for name in _FACTS}
    fps = options.fps or found.fps
    return Motion.from_positions(skeleton, found.positions, fps, {"read_from": facts}, lower=found.lower)


def _bvh_skeleton(bvh: Bvh, path: pathlib.Path, joint_map: str) -> str:
    """Return the first of `SKELETONS` whose joints a file has; say so where it has a part of the fingers."""
    with_hands, without = map(load_skeleton, SKELETONS)
    try:
        joint_maps.choose_map(bvh.joints, with_hands, joint_map, path)
    except UserError:
        pass
    else:
        return with_hands.name
    try:
        chosen, _ = joint_maps.choose_map(bvh.joints, without, joint_map, path)
    except UserError:
        return without.name  # reading then raises an error that says what is missing
    hands = [with_hands.joints[number] for number in hand_joints(with_hands)]
    fingers = [joint for joint in hands if joint not in without.joints]
    found = joint_maps.find(chosen, bvh.joints, fingers, path)
    if 0 < len(found) < len(fingers):
        missing = [joint for joint in fingers if joint not in found]
        _logger.warning("%s is read without hands, as it lacks %s", shown(path.name), ", ".join(missing))
    return without.name


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
            smplx_arrays.to_arrays(arrays, options.source_fps, options.unit), skeleton, template(), fps=options.fps
        )
    array_files.check_positions(found.positions.astype(np.float64), skeleton, content.path)
    if not found.is_good.any():
        raise UserError(f"{shown(content.path)} has no frame in which the person was tracked; give another file")
    if num_bad := int((~found.is_good).sum()):
        text = "%s: in %d of %d frames the person was not tracked; they hold the nearest pose"
        _logger.warning(text, shown(content.path.name), num_bad, len(found.is_good))
    meta = {"read_from": {"kind": "SMPL-X", "fps": found.fps, "up": found.up}}
    fps = options.fps or found.fps
    return Motion.from_positions(skeleton, found.positions, fps, meta, lower=found.lower, face=found.face)


def _read_positions(content: Content, options: _Options) -> Motion:
    return _from_positions(array_files.read_arrays(_stated(content, options), content.path), content.path, options)


def _stated(content: Content, options: _Options) -> Mapping[str, Any]:
    """Return the arrays of a file with the frame rate that the user states."""
    return content.arrays if options.source_fps is None else {**content.arrays, "fps": np.array(options.source_fps)}


def _from_positions(arrays: array_files.Arrays, path: pathlib.Path, options: _Options) -> Motion:
    skeleton = load_skeleton(options.skeleton or array_files.find_skeleton(arrays, options.joint_map, path))
    unit = options.unit
    if unit is None and options.joint_map != joint_maps.AUTO:
        unit = joint_maps.load_map(options.joint_map).unit
    positions = array_files.in_skeleton(arrays, skeleton, options.joint_map, path) * (unit or 1.0)
    meta: dict[str, Any] = {"read_from": {"kind": "positions", "fps": arrays.fps}}
    if len(arrays.borders):
        meta["borders"] = arrays.borders.tolist()
    motion = Motion.from_positions(skeleton, positions, arrays.fps, meta)
    length = arm_length(positions, skeleton, "left")
    if unit is not None:
        with naming(path):
            check_arms(length / unit, unit)
    elif not ARM_RANGE[0] <= length <= ARM_RANGE[1]:  # not in metres: take the skeleton's bones
        motion = Motion.from_directions(skeleton, motion.directions, arrays.fps, motion.meta)
    return at_rate(motion, options.fps)


def _read_directions(content: Content, options: _Options) -> Motion:
    name, fps = array_files.directions_skeleton(content.array) or SKELETONS[0], options.source_fps or array_files.FPS
    skeleton = load_skeleton(name)
    directions, is_residual = array_files.read_directions(content.array, skeleton, content.path)
    facts = {"kind": "directions", "fps": fps, "mean_was_subtracted": is_residual}
    motion = Motion.from_directions(skeleton, directions, fps, {"read_from": facts})
    return at_rate(_in_skeleton(motion, content.path, options), options.fps)


def _read_array(content: Content, options: _Options) -> Motion:
    """Read a `.npy` of the positions of all joints of a skeleton."""
    array, fps = content.array, options.source_fps or array_files.FPS
    for name in SKELETONS:
        joints = load_skeleton(name).joints
        if array.size and array.shape[1:] == (len(joints), 3):
            arrays = {"positions": array, "fps": np.array(fps), "joint_names": np.array(joints)}
            own = options._replace(skeleton=name)
            motion = _from_positions(array_files.read_arrays(arrays, content.path), content.path, own)
            return _in_skeleton(motion, content.path, options)
    raise UserError(
        f"{shown(content.path)} holds an array of shape {array.shape}; expected directions (T, 126), (T, 42, 3), "
        "(T, 27) or (T, 9, 3), positions (T, 43, 3) or (T, 10, 3), or joints of SMPL-X (T, 55, 3)"
    )


def at_rate(motion: Motion, fps: float | None) -> Motion:
    """Resample a motion on the sphere, without legs and face; its bones take the mean lengths of the motion."""
    if fps is None or fps == motion.fps:
        return motion
    count = num_frames(motion.num_frames / motion.fps, fps)
    meta = dict(motion.meta)
    if "borders" in meta:
        meta["borders"] = sorted({round(border * fps / motion.fps) for border in meta["borders"]})
    directions = resample(motion.directions, motion.fps, fps, count)
    return Motion.from_directions(motion.skeleton, directions, fps, meta)


_EFFECTS: dict[Callable[[Content, _Options], Motion], tuple[str, ...]] = {
    _read_own: (),
    _read_tree: ("joint_map", "source_fps", "unit"),
    _read_smplx: ("source_fps", "unit"),
    _read_directions: ("source_fps",),
    _read_positions: ("joint_map", "source_fps", "unit"),
    _read_array: ("source_fps", "unit"),
}
"""Options of `Reading` on which the motion of a file depends, by its reader."""
