"""Files of motion from any system as arrays: positions of joints, their names, and the frame rate."""

import pathlib
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.files.npz import read_npz
from ha2g_jax.files.reading import parse_json, read_bytes, reading, reason, shown
from ha2g_jax.limits import MAX_MOTION_BYTES, MAX_MOTION_FPS, MAX_MOTION_JOINTS, MAX_MOTION_JSON_BYTES, MIN_MOTION_FPS
from ha2g_jax.motion import motion as motions
from ha2g_jax.motion.checks import check_length

_ARRAYS = ("positions", "fps", "joint_names", "borders")
_MAX_GROUPS = 2_000_000  # lists of a JSON file, which take long to parse; a position of a joint is one
_EXPECTED = "expected positions (T, J, 3), fps and joint_names (J,)"


class Arrays(NamedTuple):
    """The arrays of a file.

    Attributes:
        positions: (T, J, 3) positions in any unit.
        fps: frames per second.
        joint_names: (J,) names of the joints.
        borders: (n,) first frames of windows.
    """

    positions: np.ndarray
    fps: float
    joint_names: tuple[str, ...]
    borders: np.ndarray


def read_content(path: pathlib.Path) -> Mapping[str, Any]:
    """Read what a `.npz` or `.json` has of the arrays of this module and of `Motion.save`, by name.

    Raises:
        UserError: the file cannot be read, or is too large.
    """
    if path.suffix.lower() != ".json":
        return read_npz(path, max_bytes=MAX_MOTION_BYTES, names={*motions.ARRAYS, *_ARRAYS})
    text = read_bytes(path, "a motion in JSON", MAX_MOTION_JSON_BYTES)
    if text.count(b"[") + text.count(b"{") > _MAX_GROUPS:
        raise UserError(f"{shown(path)} has more than {_MAX_GROUPS} lists; give it as .npz, or cut the motion")
    with reading(path, "a motion in JSON"):
        content = parse_json(text)
    if not isinstance(content, dict):
        raise UserError(f"{shown(path)} holds no motion but a {type(content).__name__}; {_EXPECTED}")
    return {name: content[name] for name in _ARRAYS if name in content}


def read_arrays(content: Mapping[str, Any], path: pathlib.Path) -> Arrays:
    """Convert the content of a file to arrays that fit together.

    Args:
        content: values by name, see `read_content`.
        path: path of the file, for messages.

    Raises:
        UserError: an array is missing or has another form, or the length or the frame rate is out of range.
    """
    if missing := [name for name in _ARRAYS[:3] if name not in content]:
        raise UserError(f"{shown(path)} has no {' and no '.join(missing)}; {_EXPECTED}")
    try:
        positions = _numbers(content["positions"])
        fps = float(_numbers(content["fps"]).reshape(()))
        joints = _names(content["joint_names"])
        borders = read_borders(content, len(positions) if positions.ndim else 0)
    except (ValueError, TypeError, OverflowError) as error:
        raise UserError(f"{shown(path)} holds no motion ({reason(error)}); {_EXPECTED}") from error
    if positions.ndim != 3 or positions.shape[1:] != (len(joints), 3) or not len(positions):
        raise UserError(
            f"{shown(path)} has positions of shape {positions.shape} for {len(joints)} joint names; {_EXPECTED}"
        )
    if not MIN_MOTION_FPS <= fps <= MAX_MOTION_FPS:
        raise UserError(
            f"{shown(path)} states {fps:g} frames per second; expected {MIN_MOTION_FPS:g} to {MAX_MOTION_FPS:g} under "
            "fps"
        )
    try:
        check_length(len(positions), fps)
    except UserError as error:
        raise UserError(f"{shown(path)}: {error}") from error
    return Arrays(positions, fps, joints, borders)


def read_borders(content: Mapping[str, Any], frames: int) -> np.ndarray:
    """Return the first frames of windows, (n,) whole numbers, none by default.

    Args:
        content: values by name, "borders" among them.
        frames: number of frames of the motion.

    Raises:
        ValueError, TypeError, OverflowError: they are not numbers from 0 to `frames`.
    """
    borders = _numbers(content.get("borders", ())).astype(float).reshape(-1)
    if not ((borders >= 0) & (borders <= frames)).all():
        raise ValueError(f"borders that are not from 0 to {frames}")
    return borders.astype(int)


def _numbers(values: Any) -> np.ndarray:
    if isinstance(values, np.ndarray) and values.dtype.kind in "biuf":
        return values
    return np.asarray(values, float)


def _names(values: Any) -> tuple[str, ...]:
    if not isinstance(values, list | np.ndarray) or len(values) > MAX_MOTION_JOINTS:
        raise ValueError(f"joint_names that are no list of at most {MAX_MOTION_JOINTS} names")
    return tuple(str(name) for name in values)
