"""Limits of what is read, and untrusted texts in one printable line."""

import os
import pathlib
from collections.abc import Sequence

import numpy as np

MAX_FRAMES, MAX_JOINTS = 1_000_000, 1_000
MAX_POSES = 10_000_000  # frames times joints; their rotations take a gigabyte while they are read
MIN_FPS, MAX_FPS = 0.1, 1_000.0
MAX_POINTS, MAX_FACES, MAX_MATERIALS = 200_000, 400_000, 100

_MAX_METRES = 1e6
_MAX_NAME = 63  # bytes of a name in Blender, which cuts longer ones
_UNIT = 0.01  # by which the length of a quaternion may differ from 1


def read_bytes(path: pathlib.Path, most: int) -> bytes:
    """Read a whole file of at most `most` bytes.

    Raises:
        ValueError: the file is larger.
    """
    with path.open("rb") as file:
        content = file.read(most + 1)
    if len(content) > most:
        raise ValueError(f"more than {most} bytes")
    return content


def check_size(frames: int, joints: int) -> None:
    """Check the size of a motion, before arrays of this size are made.

    Raises:
        ValueError: there are none or too many frames or joints.
    """
    if not 1 <= frames <= MAX_FRAMES or not 1 <= joints <= MAX_JOINTS or frames * joints > MAX_POSES:
        raise ValueError(
            f"{frames} frames of {joints} joints, expected 1 to {MAX_FRAMES} frames, 1 to {MAX_JOINTS} joints and at "
            f"most {MAX_POSES} of both multiplied"
        )


def check_joints(joints: Sequence[str], parents: Sequence[int]) -> None:
    """Check the names of joints, and that each comes after its parent.

    Raises:
        ValueError: a name cannot be that of a bone, two are alike, or a parent is not before its joint.
    """
    for index, (name, parent) in enumerate(zip(joints, parents)):
        if not isinstance(name, str) or not 1 <= len(name.encode()) <= _MAX_NAME or not name.isprintable():
            raise ValueError(f"joint {index} has no name of 1 to {_MAX_NAME} letters")
        if not isinstance(parent, int) or not -1 <= parent < index:
            raise ValueError(f"the parent of joint {name} does not come before it")
    if len(set(joints)) < len(joints):
        raise ValueError("two joints have one name")


def check_values(places: Sequence[np.ndarray], quaternions: Sequence[np.ndarray]) -> None:
    """Check positions and rotations.

    Args:
        places: arrays (..., 3) in metres.
        quaternions: arrays (..., 4).

    Raises:
        ValueError: an array has another form, a value is no number, or a quaternion has not the length 1.
    """
    for values, width in (*((values, 3) for values in places), *((values, 4) for values in quaternions)):
        if values.ndim < 2 or values.shape[-1] != width:
            raise ValueError(f"an array of shape {values.shape}")
        if not np.isfinite(values).all() or np.abs(values).max(initial=0) > _MAX_METRES:
            raise ValueError("values that are not numbers, or too large")
    for values in quaternions:
        if np.abs(np.linalg.norm(values, axis=-1) - 1).max(initial=0) > _UNIT:
            raise ValueError("rotations that are no unit quaternions")


def shown(text: str | os.PathLike) -> str:
    """Return a path or another text in one printable line of at most 200 letters, as Blender can show it."""
    text = str(text)
    text = "".join(letter if letter.isprintable() else ascii(letter)[1:-1] for letter in text[:1000])
    return text if len(text) <= 200 else f"{text[:100]}...{text[-100:]}"


def reason(error: Exception) -> str:
    """Return what an exception of a reader says about the file, in one line."""
    if isinstance(error, TypeError | AttributeError):
        return "a value of another kind than expected"
    if isinstance(error, KeyError):
        return f"it has no {shown(str(error))}"
    if isinstance(error, RecursionError):
        return "nested too deep"
    return shown(" ".join(str(error).split()) or type(error).__name__)
