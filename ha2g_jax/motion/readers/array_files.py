"""Arrays without a body model: positions of named joints, and bare direction vectors.

Positions have any order of joints, more joints than the skeleton's and any right-handed axes. Motion with y down and
the person's left where the skeleton has it is taken as it is, other motion is rotated as one rigid body. `borders`, the
first frames of windows that the motion was joined from, may stand beside the positions.

Models of the TED data sets write direction vectors with or without the mean of the data subtracted. Such an array
states neither its frame rate, which is that of the TED data unless another is given, nor whether the mean was
subtracted. The latter shows in whether lengths are 1 before or after the mean is added. Outputs of networks do not have
unit length; for them, it also matters whether the vectors resemble the mean.
"""

import logging
import pathlib
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import naming, reason, shown
from ha2g_jax.limits import MAX_MOTION_JOINTS
from ha2g_jax.motion.motion import check_length
from ha2g_jax.motion.readers import joint_maps
from ha2g_jax.motion.readers.body import choose_up, is_mirrored, to_skeleton_axes
from ha2g_jax.skeleton import SKELETONS, Skeleton, bone_lengths, hand_joints, load_skeleton

_logger = logging.getLogger(__name__)

ARRAYS = ("positions", "fps", "joint_names", "borders")
EXPECTED = "expected positions (T, J, 3), fps (or --source-fps) and joint_names (J,)"

_MIN_LENGTH = 1e-6  # metres of a bone that has a direction
_MAX_PLACE = 1e9  # in any unit; the squares of greater numbers lose their digits
_OURS_DOWN = "-y"  # the axis that points up where y points down
_LISTED = 12
FPS = 15.0  # frames per second of the TED data

_EXACT = 0.02  # median difference of the lengths from 1 that rounding explains
_MAX_ERROR = 0.35  # the same for outputs of networks
_MAX_VALUE = 1e3
_ALIKE, _UNLIKE = 0.7, 0.3  # fraction of the mean that direction vectors have, and residuals have not


class Arrays(NamedTuple):
    """The arrays of a file: (T, J, 3) positions in any unit, J names, and (n,) borders, the first frames of windows."""

    positions: np.ndarray
    fps: float
    joint_names: tuple[str, ...]
    borders: np.ndarray


def read_arrays(content: Mapping[str, Any], path: pathlib.Path) -> Arrays:
    """Convert the content of a file to arrays that fit together.

    Raises:
        UserError: an array is missing or has another form, or the length or the frame rate is out of range.
    """
    if missing := [name for name in ARRAYS[:3] if name not in content]:
        raise UserError(f"{shown(path)} has no {' and no '.join(missing)}; {EXPECTED}")
    try:
        positions = _numbers(content["positions"])
        fps = float(_numbers(content["fps"]).reshape(()))
        joints = _names(content["joint_names"])
        borders = read_borders(content, len(positions) if positions.ndim else 0)
    except (ValueError, TypeError, OverflowError) as error:
        raise UserError(f"{shown(path)} holds no motion ({reason(error)}); {EXPECTED}") from error
    if positions.ndim != 3 or positions.shape[1:] != (len(joints), 3) or not len(positions):
        raise UserError(
            f"{shown(path)} has positions of shape {positions.shape} for {len(joints)} joint names; {EXPECTED}"
        )
    with naming(path):
        check_length(len(positions), fps)
    return Arrays(positions, fps, joints, borders)


def read_borders(content: Mapping[str, Any], frames: int) -> np.ndarray:
    """Return the first frames of windows, (n,) different whole numbers in ascending order, none by default.

    Raises:
        ValueError, TypeError, OverflowError: they are not whole numbers from 0 to `frames`.
    """
    borders = _numbers(content.get("borders", ())).astype(float).reshape(-1)
    if not ((borders >= 0) & (borders <= frames) & (borders == np.round(borders))).all():
        raise ValueError(f"borders that are not whole numbers from 0 to {frames}")
    return np.unique(borders.astype(int))


def find_skeleton(arrays: Arrays, joint_map: str, path: pathlib.Path) -> str:
    """Return the name of the first skeleton whose joints the arrays have; say so where they have a part of the fingers.

    Raises:
        UserError: they lack joints of every skeleton.
    """
    skeletons = [load_skeleton(name) for name in SKELETONS]
    missing = [_find_joints(arrays.joint_names, skeleton, joint_map)[1] for skeleton in skeletons]
    if all(missing):
        nearest = min(range(len(missing)), key=lambda index: len(missing[index]))
        raise _lacks(path, arrays.joint_names, SKELETONS[nearest], missing[nearest])
    found = missing.index([])
    fingers = {skeletons[0].joints[joint] for joint in hand_joints(skeletons[0])} - {*skeletons[found].joints}
    lacking = [joint for joint in missing[0] if joint in fingers]
    if 0 < len(lacking) < len(fingers):
        _logger.warning("%s is read without hands, as it lacks %s", shown(path.name), ", ".join(lacking))
    return SKELETONS[found]


def in_skeleton(arrays: Arrays, skeleton: Skeleton, joint_map: str, path: pathlib.Path) -> np.ndarray:
    """Return positions (T, joints, 3) of the joints of a skeleton in its axes, float64, in the unit of the file.

    The map names joints beside the names of the skeleton, see `joint_maps`. A warning in the log names a file whose
    fingers bend backwards, as in left-handed axes.

    Raises:
        UserError: joints are missing, or the positions are no motion.
    """
    places, missing = _find_joints(arrays.joint_names, skeleton, joint_map)
    if missing:
        raise _lacks(path, arrays.joint_names, skeleton.name, missing)
    if twice := [joint for joint, place in zip(skeleton.joints, places, strict=True) if places.count(place) > 1]:
        raise UserError(f"{shown(path)} has one joint for {twice[0]} and {twice[1]}; correct the map (--joint-map)")
    positions = arrays.positions[:, places].astype(np.float64)
    check_positions(positions, skeleton, path)
    if is_mirrored(positions, skeleton):
        _logger.warning(
            "%s looks mirrored, as in left-handed axes: the fingers bend to the backs of the hands; export it with "
            "right-handed axes",
            shown(path),
        )
    left, right = (skeleton.joint(f"{side}_shoulder") for side in ("left", "right"))
    stated = None if joint_map == joint_maps.AUTO else joint_maps.load_map(joint_map).up
    side = np.sign((positions[:, left, 0] - positions[:, right, 0]).mean())
    with naming(path):
        up = choose_up(positions, skeleton, stated)
        if up == _OURS_DOWN and side == skeleton.left:
            return positions
        return to_skeleton_axes(positions, skeleton, up=up)


def check_positions(positions: np.ndarray, skeleton: Skeleton, path: pathlib.Path) -> None:
    """Raise a UserError if a position (T, joints, 3) is not finite or too far away, or a bone has no length."""
    if not np.isfinite(positions).all():
        frame, joint, _ = np.argwhere(~np.isfinite(positions))[0]
        raise UserError(
            f"{shown(path)} has a position that is not a number, of {skeleton.joints[joint]} in frame {frame}; "
            "export it again"
        )
    if (largest := np.abs(positions).max()) > _MAX_PLACE:
        raise UserError(
            f"{shown(path)} has a position of {largest:.4g}; expected at most {_MAX_PLACE:g}: export it again"
        )
    lengths = bone_lengths(skeleton, positions)
    if (lengths < _MIN_LENGTH).any():
        frame, bone = np.argwhere(lengths < _MIN_LENGTH)[0]
        parent, child = (skeleton.joints[joint] for joint in skeleton.bones[bone])
        raise UserError(
            f"{shown(path)} has {parent} and {child} in one place in frame {frame}, so that the bone between them has "
            "no direction; export it again"
        )


def _find_joints(names: tuple[str, ...], skeleton: Skeleton, joint_map: str) -> tuple[list[int], list[str]]:
    """Return the places of the skeleton's joints among the names, and the joints that are missing."""
    mapped = {} if joint_map == joint_maps.AUTO else joint_maps.load_map(joint_map).names
    own = joint_maps.JointMap("own", {joint: (*mapped.get(joint, ()), joint) for joint in skeleton.joints}, None, None)
    places = joint_maps.find(own, names, skeleton.joints, "the list of joints")
    return list(places.values()), [joint for joint in skeleton.joints if joint not in places]


def _lacks(path: pathlib.Path, names: tuple[str, ...], skeleton: str, missing: list[str]) -> UserError:
    found, lacking = _few([shown(name[:40]) for name in names]), _few(missing)
    return UserError(
        f"{shown(path)} lacks {lacking} of the skeleton {skeleton}; it has {found}; "
        "name the joints as the skeleton does, or give a map (--joint-map)"
    )


def _few(names: list[str]) -> str:
    return ", ".join(names[:_LISTED]) + (", ..." if len(names) > _LISTED else "")


def _numbers(values: Any) -> np.ndarray:
    if isinstance(values, np.ndarray) and values.dtype.kind in "biuf":
        return values
    return np.asarray(values, float)


def _names(values: Any) -> tuple[str, ...]:
    values = values.ravel().tolist() if isinstance(values, np.ndarray) else values
    if not isinstance(values, list) or len(values) > MAX_MOTION_JOINTS:
        raise ValueError(f"joint_names that are no list of at most {MAX_MOTION_JOINTS} names")
    return tuple(name.decode() if isinstance(name, bytes) else str(name) for name in values)


def directions_skeleton(array: np.ndarray) -> str | None:
    """Return the name of the skeleton whose direction vectors an array has by its shape, None without one."""
    for name in SKELETONS:
        bones = load_skeleton(name).num_bones
        if array.size and array.shape[1:] in ((3 * bones,), (bones, 3)):
            return name
    return None


def read_directions(array: np.ndarray, skeleton: Skeleton, path: pathlib.Path) -> tuple[np.ndarray, bool]:
    """Return the directions (T, bones, 3) of an array, and whether `skeleton.mean_directions` was added to them.

    The array is (T, bones, 3) or (T, 3 * bones); the result is float64 of any positive length.

    Raises:
        UserError: the array has no numbers, or its lengths are those of neither.
    """
    if array.dtype.kind not in "fiu" or not (np.abs(array.astype(np.float64)) <= _MAX_VALUE).all():
        raise UserError(f"{shown(path)} holds values that are not numbers or are too large; expected direction vectors")
    whole = array.astype(np.float64).reshape(len(array), skeleton.num_bones, 3)
    added = whole + skeleton.mean_directions
    errors = [float(np.median(np.abs(np.linalg.norm(vectors, axis=-1) - 1))) for vectors in (whole, added)]
    mean = skeleton.mean_directions
    share = float(np.sum(whole.mean(axis=0) * mean) / np.sum(mean * mean))
    if errors[0] <= _EXACT or (errors[0] <= _MAX_ERROR and share >= _ALIKE):
        return whole, False
    if errors[1] <= _EXACT or (errors[1] <= _MAX_ERROR and share <= _UNLIKE):
        return added, True
    raise UserError(
        f"{shown(path)} has vectors whose lengths differ from 1 by {errors[0]:.2f}, and by {errors[1]:.2f} with the "
        f"mean of {skeleton.name} added; expected direction vectors, or the same less this mean: add what is missing"
    )
