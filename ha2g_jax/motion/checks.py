"""Validation of a motion: what it must be before it is converted, drawn, exported or continued."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.limits import MAX_FACE_VALUES, MAX_MOTION_FPS, MAX_MOTION_FRAMES, MAX_MOTION_SECONDS, MIN_MOTION_FPS
from ha2g_jax.skeleton import SKELETONS, Skeleton, load_skeleton

MAX_METRES = 100.0

_MIN_LENGTH, _MAX_LENGTH = 1e-3, 1e3  # of a direction vector, which should have length 1
_MIN_BONE = 1e-3  # metres between the two joints of a bone
_BLOCK = 10_000  # frames that are looked at together, so that a long motion needs no second copy


def check(
    directions: np.ndarray, positions: np.ndarray, fps: float, joint_names: Sequence[str], meta: Mapping[str, Any]
) -> None:
    """Check the parts of a motion, whose meaning is that of the attributes of `motion.Motion`.

    Args:
        directions: (T, bones, 3) unit direction vectors.
        positions: (T, joints, 3) metres.
        fps: frames per second.
        joint_names: names of the joints.
        meta: facts with the name of the skeleton.

    Raises:
        UserError: the skeleton or the joints are unknown, the arrays do not fit together, there are no or too many
            frames, the frame rate is out of range, a value is not finite, a direction vector has no usual length, a
            bone has no length, or a position is too far away.
    """
    name = meta.get("skeleton")
    if name not in SKELETONS:
        raise UserError(f"the motion has skeleton {str(name)[:40]!r}; expected {' or '.join(SKELETONS)}")
    skeleton = load_skeleton(name)
    if tuple(joint_names) != skeleton.joints:
        pairs = zip(joint_names, skeleton.joints, strict=False)
        first = next((f"{str(found)[:40]!r} for {ours}" for found, ours in pairs if found != ours), "another number")
        raise UserError(
            f"the motion has {len(joint_names)} joints, not the {skeleton.num_joints} of {name} ({first}); "
            "give one that ha2g generate wrote"
        )
    frames = directions.shape[0] if directions.ndim else 0
    for kind, array, count in (
        ("directions", directions, skeleton.num_bones),
        ("positions", positions, skeleton.num_joints),
    ):
        if array.shape != (frames, count, 3) or array.dtype.kind != "f":
            raise UserError(
                f"the motion's {kind} are {array.dtype} of shape {array.shape}; expected floats, {(frames, count, 3)}"
            )
    check_length(frames, fps)
    _check_values(directions, positions, skeleton)


def check_length(frames: int, fps: float) -> None:
    """Check the number of frames of a motion, their rate, and the length in seconds that follows.

    Args:
        frames: number of frames.
        fps: frames per second.

    Raises:
        UserError: one of the three is out of range.
    """
    if not 1 <= frames <= MAX_MOTION_FRAMES:
        raise UserError(
            f"the motion has {frames} frames; expected 1 to {MAX_MOTION_FRAMES}: cut it, or generate at a lower frame "
            "rate"
        )
    if not MIN_MOTION_FPS <= fps <= MAX_MOTION_FPS:
        raise UserError(
            f"the motion has {fps} frames per second; expected {MIN_MOTION_FPS} to {MAX_MOTION_FPS}: give its true rate"
        )
    if frames > MAX_MOTION_SECONDS * fps:
        raise UserError(
            f"the motion has {frames / fps:.0f} seconds, {frames} frames at {fps:g} a second; expected at most "
            f"{MAX_MOTION_SECONDS}: cut it"
        )


def check_face(face: Mapping[str, np.ndarray], frames: int) -> None:
    """Check the passengers of a motion, see `motion.Motion.face`.

    Args:
        face: arrays (T, n) by name.
        frames: number of frames of the motion.

    Raises:
        UserError: an array has another shape, or values that are not finite or too large.
    """
    for name, values in face.items():
        if values.ndim != 2 or len(values) != frames or values.dtype.kind != "f" or values.shape[1] > MAX_FACE_VALUES:
            raise UserError(
                f"the motion's face_{name} are {values.dtype} of shape {values.shape}; expected floats, "
                f"({frames}, at most {MAX_FACE_VALUES})"
            )
        if not (np.abs(values) <= _MAX_LENGTH).all():
            raise UserError(f"the motion's face_{name} have values that are not finite or too large; export it again")


def _check_values(directions: np.ndarray, positions: np.ndarray, skeleton: Skeleton) -> None:
    parents, children = (list(ends) for ends in zip(*skeleton.bones, strict=True))
    ends = [skeleton.joints[child] for child in children]
    for start, (vectors, places) in _blocks(directions, positions):
        for kind, array, names in (
            ("direction of the bone to", vectors, ends),
            ("position of", places, skeleton.joints),
        ):
            is_bad = ~np.isfinite(array).all(axis=-1)
            if is_bad.any():
                frame, index = np.argwhere(is_bad)[0]
                raise UserError(
                    f"the {kind} {names[index]} in frame {start + frame} is not a number; expected finite values: "
                    "generate the motion again"
                )
        if (largest := float(np.abs(places).max())) > MAX_METRES:
            raise UserError(f"a joint of the motion is {largest:.4g} m away; expected metres, within {MAX_METRES:g}")
        # The largest part of a vector, because the square of an odd number may be infinite.
        lengths = np.abs(vectors).max(axis=-1)
        is_odd = (lengths < _MIN_LENGTH) | (lengths > _MAX_LENGTH)
        if is_odd.any():
            frame, bone = np.argwhere(is_odd)[0]
            raise UserError(
                f"the bone to {ends[bone]} in frame {start + frame} has a direction of length "
                f"{lengths[frame, bone]:.4g}; expected unit vectors: generate the motion again"
            )
    bones = np.linalg.norm(positions[0, children].astype(np.float64) - positions[0, parents], axis=-1)
    if (bones < _MIN_BONE).any():
        bone = int(np.argmin(bones))
        raise UserError(
            f"the bone to {ends[bone]} is {bones[bone]:.4g} m long; expected at least {_MIN_BONE}: generate the motion "
            "again"
        )


def _blocks(*arrays: np.ndarray) -> Iterator[tuple[int, tuple[np.ndarray, ...]]]:
    """Yield the first frame and the arrays of one block of frames after the other."""
    for start in range(0, len(arrays[0]), _BLOCK):
        yield start, tuple(array[start : start + _BLOCK] for array in arrays)
