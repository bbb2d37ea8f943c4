"""The table of all kinds of motion that are read, and how a file of each becomes a `Motion`."""

import dataclasses
import pathlib
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import reason, shown
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.readers import direction_arrays, joint_maps, named_positions, smplx, smplx_arrays
from ha2g_jax.motion.readers.bvh import read_bvh
from ha2g_jax.motion.readers.bvh_joints import read_motion as read_captured
from ha2g_jax.motion.readers.content import Content
from ha2g_jax.motion.readers.smplx_template import template
from ha2g_jax.motion.resample import num_frames, resample
from ha2g_jax.skeleton import SKELETONS, Skeleton, load_skeleton

_ARM = (0.3, 1.0)  # metres from shoulder to wrist of a person


class Options(NamedTuple):
    """How a file is read.

    Attributes:
        fps: frames per second of the result, None for those of the file.
        source_fps: frames per second of a file that does not say it, None without.
        joint_map: names of the joints, see `joint_maps`.
    """

    fps: float | None = None
    source_fps: float | None = None
    joint_map: str = joint_maps.AUTO


class Kind(NamedTuple):
    """A kind of motion.

    Attributes:
        name: name of the kind, as in the documentation.
        matches: function of the content of a file to whether it is of this kind.
        find_skeleton: function of the content and the options to the name of the skeleton that suits it.
        read: function of the content, a skeleton and the options to the motion.
    """

    name: str
    matches: Callable[[Content], bool]
    find_skeleton: Callable[[Content, Options], str]
    read: Callable[[Content, Skeleton, Options], Motion]


def _is_own(content: Content) -> bool:
    return "directions" in content.arrays and "meta" in content.arrays


def _own_skeleton(content: Content, options: Options) -> str:
    return Motion.from_arrays(content.arrays, content.path).meta["skeleton"]


def _read_own(content: Content, skeleton: Skeleton, options: Options) -> Motion:
    motion = Motion.from_arrays(content.arrays, content.path)
    if motion.meta["skeleton"] != skeleton.name:
        raise UserError(
            f"{shown(content.path)} has the skeleton {motion.meta['skeleton']}, not {skeleton.name} as the others; "
            "evaluate motion of one skeleton at a time"
        )
    if "borders" in content.arrays:
        facts = motion.meta | {"borders": content.arrays["borders"]}
        motion = dataclasses.replace(motion, meta=facts)
        motion.meta["borders"] = list(borders_of(motion, content.path))
    return motion


def _read_bvh(content: Content, skeleton: Skeleton, options: Options) -> Motion:
    found = read_captured(content.path, skeleton, fps=options.fps, joint_map=options.joint_map, with_legs=True)
    named_positions.check_positions(found.positions.astype(np.float64), skeleton, content.path)
    facts = {"kind": BVH, "fps": found.fps, "joint_map": found.joint_map, "unit": found.unit, "up": found.up}
    fps = options.fps or found.fps
    return Motion.from_positions(skeleton, found.positions, fps, {"read_from": facts}, lower=found.lower)


def _bvh_skeleton(content: Content, options: Options) -> str:
    joints = read_bvh(content.path).joints
    for name in SKELETONS[:-1]:
        try:
            joint_maps.choose_map(joints, load_skeleton(name), options.joint_map, content.path)
        except UserError:
            continue
        return name
    return SKELETONS[-1]  # the error at reading then says what is missing


def _has_smplx_positions(content: Content) -> bool:
    arrays = content.arrays
    if "joint_names" in arrays:
        return False
    found = [arrays[name] for name in smplx_arrays.POSITIONS if name in arrays] or [content.array]
    return isinstance(found[0], np.ndarray) and found[0].ndim == 3 and found[0].shape[1] in smplx_arrays.NUM_POSITIONS


def _read_smplx(content: Content, skeleton: Skeleton, options: Options) -> Motion:
    arrays = content.arrays or {smplx_arrays.POSITIONS[0]: content.array}
    try:
        found = smplx.to_motion(
            smplx_arrays.to_arrays(arrays, options.source_fps), skeleton, template(), fps=options.fps
        )
    except UserError as error:
        raise UserError(f"{shown(content.path)}: {error}") from error
    named_positions.check_positions(found.positions.astype(np.float64), skeleton, content.path)
    meta = {"read_from": {"kind": SMPLX, "fps": found.fps, "up": found.up}}
    fps = options.fps or found.fps
    return Motion.from_positions(skeleton, found.positions, fps, meta, lower=found.lower, face=found.face)


def _read_named(content: Content, skeleton: Skeleton, options: Options) -> Motion:
    arrays = named_positions.read_arrays(content.arrays, content.path)
    return _from_named(arrays, content.path, skeleton, options)


def _from_named(arrays: named_positions.Arrays, path: pathlib.Path, skeleton: Skeleton, options: Options) -> Motion:
    positions = named_positions.in_skeleton(arrays, skeleton, options.joint_map, path)
    meta: dict[str, Any] = {"read_from": {"kind": POSITIONS, "fps": arrays.fps}}
    if len(arrays.borders):
        meta["borders"] = arrays.borders.tolist()
    motion = Motion.from_positions(skeleton, positions, arrays.fps, meta)
    arm = [skeleton.joint(f"left_{part}") for part in ("shoulder", "elbow", "wrist")]
    length = float(np.median(np.linalg.norm(np.diff(positions[:, arm], axis=1), axis=-1).sum(axis=-1)))
    if not _ARM[0] <= length <= _ARM[1]:  # not in metres: the bones of the skeleton take the place of the file's
        motion = Motion.from_directions(skeleton, motion.directions, arrays.fps, motion.meta)
    return _at_rate(motion, skeleton, options.fps)


def _named_skeleton(content: Content, options: Options) -> str:
    arrays = named_positions.read_arrays(content.arrays, content.path)
    return named_positions.find_skeleton(arrays, options.joint_map, content.path)


def _array_skeleton(content: Content, options: Options) -> str:
    name = direction_arrays.find_skeleton(content.array)
    if name is None:
        joints = [name for name in SKELETONS if content.array.shape[1:] == (load_skeleton(name).num_joints, 3)]
        name = joints[0] if joints and content.array.size else None
    if name is None:
        raise UserError(
            f"{shown(content.path)} holds an array of shape {content.array.shape}; expected directions (T, 126), "
            "(T, 42, 3), (T, 27) or (T, 9, 3), positions (T, 43, 3) or (T, 10, 3), or joints of SMPL-X (T, 55, 3)"
        )
    return name


def _read_array(content: Content, skeleton: Skeleton, options: Options) -> Motion:
    own = _array_skeleton(content, options)
    if own != skeleton.name:
        raise UserError(f"{shown(content.path)} has the skeleton {own}, not {skeleton.name} as the others")
    fps = options.source_fps or direction_arrays.FPS
    if direction_arrays.find_skeleton(content.array) is None:
        arrays = {"positions": content.array, "fps": np.array(fps), "joint_names": np.array(skeleton.joints)}
        return _from_named(named_positions.read_arrays(arrays, content.path), content.path, skeleton, options)
    directions, is_residual = direction_arrays.read_directions(content.array, skeleton, content.path)
    facts = {"kind": DIRECTIONS, "fps": fps, "mean_was_subtracted": is_residual}
    motion = Motion.from_directions(skeleton, directions, fps, {"read_from": facts})
    return _at_rate(motion, skeleton, options.fps)


def _at_rate(motion: Motion, skeleton: Skeleton, fps: float | None) -> Motion:
    """Resample a motion on the sphere; its bones take the mean lengths of the motion."""
    if fps is None or fps == motion.fps:
        return motion
    count = num_frames(motion.num_frames / motion.fps, fps)
    meta = dict(motion.meta)
    if "borders" in meta:
        meta["borders"] = sorted({round(border * fps / motion.fps) for border in meta["borders"]})
    own = motion.skeleton
    return Motion.from_directions(own, resample(motion.directions, motion.fps, fps, count), fps, meta)


OWN, SMPLX, POSITIONS, BVH, DIRECTIONS = "own", "SMPL-X", "positions", "BVH", "directions"

KINDS = (
    Kind(OWN, _is_own, _own_skeleton, _read_own),
    Kind(BVH, lambda content: content.container == ".bvh", _bvh_skeleton, _read_bvh),
    Kind(
        SMPLX,
        lambda content: smplx_arrays.has_poses(content.arrays) or _has_smplx_positions(content),
        lambda content, options: SKELETONS[0],
        _read_smplx,
    ),
    Kind(DIRECTIONS, lambda content: content.container == ".npy", _array_skeleton, _read_array),
    Kind(POSITIONS, lambda content: True, _named_skeleton, _read_named),
)
"""All kinds, in the order in which they are tried; the last one takes what is left, and says what it lacks."""


def find_kind(content: Content) -> Kind:
    """Return the kind of a file, by its content."""
    return next(kind for kind in KINDS if kind.matches(content))


def borders_of(motion: Motion, path: pathlib.Path) -> tuple[int, ...]:
    """Return the first frames of the windows that a motion was joined from, as its file says.

    Raises:
        UserError: they are no frames.
    """
    try:
        return tuple(named_positions.read_borders(motion.meta, motion.num_frames).tolist())
    except (ValueError, TypeError, OverflowError) as error:
        raise UserError(
            f"{shown(path)} has borders that are not frames ({reason(error)}); generate the motion again"
        ) from error
