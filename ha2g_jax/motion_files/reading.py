"""Files of motion from any system (`.npz`, `.bvh` or `.json`) as direction vectors of a skeleton.

- `.npz` written by `ha2g generate`, taken as it is;
- `.npz` with the arrays `positions` (T, J, 3), `fps` and `joint_names` (J,), or `.json` with the same under the same
  names: any order of joints, more joints than the skeleton's, any right-handed axes. Motion with y down and the
  person's left where the skeleton has it is taken as it is, other motion is rotated as one rigid body;
- `.bvh` of any skeleton with a joint map.

`borders`, the first frames of windows that the motion was joined from, may stand in the first three.
"""

import pathlib
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from ha2g_jax.data.mocap import joint_maps
from ha2g_jax.data.mocap.axes import find_up, to_skeleton_axes
from ha2g_jax.data.mocap.bvh import read_bvh
from ha2g_jax.data.mocap.motion import read_motion
from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import reason, shown
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.resample import num_frames, resample
from ha2g_jax.motion_files import named_positions
from ha2g_jax.skeleton import SKELETONS, Skeleton, load_skeleton, positions_to_directions

SUFFIXES = (".npz", ".bvh", ".json")

_MIN_LENGTH = 1e-6  # metres of a bone that has a direction
_MAX_PLACE = 1e9  # in any unit; the squares of greater numbers lose their digits
_OURS_DOWN = "-y"  # the axis that points up where y points down
_LISTED = 12


class FileMotion(NamedTuple):
    """The motion of a file.

    Attributes:
        directions: (T, bones, 3) float32 unit vectors at the frame rate that was asked for.
        fps: frames per second of the file.
        borders: first frames of the windows of the motion, at the frame rate that was asked for.
    """

    directions: np.ndarray
    fps: float
    borders: tuple[int, ...]


def read_motion_file(
    path: pathlib.Path, skeleton: Skeleton, *, fps: float, joint_map: str = joint_maps.AUTO
) -> FileMotion:
    """Read a file of one of `SUFFIXES`.

    Args:
        path: path of the file.
        skeleton: skeleton of the joints to be read.
        fps: frames per second of the result; other rates are interpolated on the sphere.
        joint_map: names of the joints of BVH, see `joint_maps`; with a map, arrays may have these names too.

    Raises:
        UserError: the file cannot be read, lacks joints of the skeleton, or has values that are no motion.
    """
    if path.suffix.lower() == ".bvh":
        bvh = read_bvh(path)
        positions = read_motion(path, skeleton, fps=fps, joint_map=joint_map).positions.astype(np.float64)
        _check_positions(positions, skeleton, path)
        return FileMotion(positions_to_directions(skeleton, positions).astype(np.float32), bvh.fps, ())
    content = named_positions.read_content(path)
    if _is_ours(content):
        return _ours(path, content, skeleton, fps)
    arrays = named_positions.read_arrays(content, path)
    positions = _choose_joints(arrays, skeleton, joint_map, path)
    _check_positions(positions, skeleton, path)
    directions = positions_to_directions(skeleton, _in_skeleton_axes(positions, skeleton, path))
    return _at_rate(directions, arrays.fps, fps, arrays.borders)


def find_skeleton(path: pathlib.Path, joint_map: str = joint_maps.AUTO) -> str:
    """Return the name of the first skeleton whose joints a file has.

    Raises:
        UserError: none of them, or the file cannot be read.
    """
    if path.suffix.lower() == ".bvh":
        joints = read_bvh(path).joints
        for name in SKELETONS[:-1]:
            try:
                joint_maps.choose_map(joints, load_skeleton(name), joint_map, path)
            except UserError:
                continue
            return name
        return SKELETONS[-1]  # the error at reading then says what is missing
    content = named_positions.read_content(path)
    if _is_ours(content):
        return Motion.from_arrays(content, path).meta["skeleton"]
    arrays = named_positions.read_arrays(content, path)
    for name in SKELETONS:
        if not _find_joints(arrays.joint_names, load_skeleton(name), joint_map)[1]:
            return name
    lacking = _find_joints(arrays.joint_names, load_skeleton(SKELETONS[-1]), joint_map)[1]
    raise _lacks(path, arrays.joint_names, SKELETONS[-1], lacking)


def _is_ours(content: Mapping[str, Any]) -> bool:
    return "directions" in content and "meta" in content


def _ours(path: pathlib.Path, content: Mapping[str, Any], skeleton: Skeleton, fps: float) -> FileMotion:
    motion = Motion.from_arrays(content, path)
    if motion.meta["skeleton"] != skeleton.name:
        raise UserError(
            f"{shown(path)} has the skeleton {motion.meta['skeleton']}, not {skeleton.name} as the others; evaluate "
            "motion of one skeleton at a time"
        )
    try:
        borders = named_positions.read_borders(motion.meta | dict(content), motion.num_frames)
    except (ValueError, TypeError, OverflowError) as error:
        raise UserError(
            f"{shown(path)} has borders that are no frames ({reason(error)}); generate the motion again"
        ) from error
    return _at_rate(motion.directions, motion.fps, fps, borders)


def _choose_joints(
    arrays: named_positions.Arrays, skeleton: Skeleton, joint_map: str, path: pathlib.Path
) -> np.ndarray:
    places, missing = _find_joints(arrays.joint_names, skeleton, joint_map)
    if missing:
        raise _lacks(path, arrays.joint_names, skeleton.name, missing)
    return arrays.positions[:, places].astype(np.float64)


def _find_joints(names: tuple[str, ...], skeleton: Skeleton, joint_map: str) -> tuple[list[int], list[str]]:
    """Return the places of the skeleton's joints among the names, and the joints that are missing."""
    plain = {name.casefold(): index for index, name in reversed(list(enumerate(names)))}
    mapped = {} if joint_map == joint_maps.AUTO else joint_maps.load_map(joint_map).names
    places, missing = [], []
    for joint in skeleton.joints:
        known = [plain[name.casefold()] for name in (*mapped.get(joint, ()), joint) if name.casefold() in plain]
        places.extend(known[:1])
        missing.extend([] if known else [joint])
    return places, missing


def _lacks(path: pathlib.Path, names: tuple[str, ...], skeleton: str, missing: list[str]) -> UserError:
    found, lacking = _few([_printable(name) for name in names]), _few(missing)
    return UserError(
        f"{shown(path)} lacks {lacking} of the skeleton {skeleton}; it has {found}; "
        "name the joints as the skeleton does, or give a map (--joint-map)"
    )


def _few(names: list[str]) -> str:
    return ", ".join(names[:_LISTED]) + (", ..." if len(names) > _LISTED else "")


def _printable(name: str) -> str:
    return "".join(letter if letter.isprintable() else "?" for letter in name[:40])


def _in_skeleton_axes(positions: np.ndarray, skeleton: Skeleton, path: pathlib.Path) -> np.ndarray:
    left, right = (skeleton.joint(f"{side}_shoulder") for side in ("left", "right"))
    up = find_up(positions, skeleton)
    is_ours = np.sign((positions[:, left, 0] - positions[:, right, 0]).mean())
    if up == _OURS_DOWN and is_ours == np.sign(skeleton.mean_pose[left, 0] - skeleton.mean_pose[right, 0]):
        return positions
    try:
        return to_skeleton_axes(positions, skeleton, up=up)
    except UserError as error:
        raise UserError(f"{shown(path)}: {error}") from error


def _check_positions(positions: np.ndarray, skeleton: Skeleton, path: pathlib.Path) -> None:
    """Raise UserError where positions (T, joints, 3) are not finite or a bone has no length."""
    if not np.isfinite(positions).all():
        frame, joint, _ = np.argwhere(~np.isfinite(positions))[0]
        raise UserError(
            f"{shown(path)} has a position that is no number, of {skeleton.joints[joint]} in frame {frame}; "
            "export it again"
        )
    if (largest := np.abs(positions).max()) > _MAX_PLACE:
        raise UserError(
            f"{shown(path)} has a position of {largest:.4g}; expected at most {_MAX_PLACE:g}: export it again"
        )
    parents, children = (list(ends) for ends in zip(*skeleton.bones, strict=True))
    lengths = np.linalg.norm(positions[:, children] - positions[:, parents], axis=-1)
    if (lengths < _MIN_LENGTH).any():
        frame, bone = np.argwhere(lengths < _MIN_LENGTH)[0]
        parent, child = (skeleton.joints[joint] for joint in skeleton.bones[bone])
        raise UserError(
            f"{shown(path)} has {parent} and {child} in one place in frame {frame}, so that the bone between them has "
            "no direction; export it again"
        )


def _at_rate(directions: np.ndarray, fps: float, new_fps: float, borders: np.ndarray) -> FileMotion:
    count = num_frames(len(directions) / fps, new_fps)
    places = tuple(sorted({round(border * new_fps / fps) for border in borders.tolist()}))
    if fps == new_fps:
        return FileMotion(np.asarray(directions, np.float32), fps, places)
    return FileMotion(resample(directions, fps, new_fps, count), fps, places)
