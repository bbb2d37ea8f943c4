"""Reader of SMPL-X motion as joints of a skeleton: axis-angle poses (BEAT2, AMASS) or positions of joints (ExPose)."""

import os
import pathlib
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from ha2g_jax.errors import UserError
from ha2g_jax.files.npz import read_npz
from ha2g_jax.files.reading import check_regular, naming
from ha2g_jax.motion.armature import export_axes
from ha2g_jax.motion.lower_body import JOINTS as LOWER_JOINTS
from ha2g_jax.motion.lower_body import LowerBody
from ha2g_jax.motion.readers.body import (
    MAX_MINUTES,
    add_face,
    add_rest_face,
    arm_length,
    check_arms,
    check_size,
    choose_up,
    from_rest_pose,
    mean_heading,
    to_skeleton_axes,
)
from ha2g_jax.motion.readers.smplx_arrays import NAMES, POSES, POSITIONS, SmplxArrays, is_embody, read_embody, to_arrays
from ha2g_jax.motion.readers.smplx_body import FACE, HEAD, JOINTS, PARENTS, Body
from ha2g_jax.motion.resample import moments_at
from ha2g_jax.skeleton import Skeleton

_MAX_BYTES = 1 << 28
_CHEST = "spine3"  # joint used as `spine` of the skeletons, whose trunk is the bone from here to the neck
_LOWER = [JOINTS.index(name) for name in LOWER_JOINTS]


class SmplxMotion(NamedTuple):
    """The motion of a file in `seconds`, and how the file was interpreted.

    Attributes:
        positions: (T, joints, 3) metres in the skeleton's axes, float32.
        fps: frames per second of the file.
        kind: "poses" or "positions of N joints".
        up: axis of the file that points up.
        lower: pelvis and legs; None for positions.
        face: values (T, n) by name, which exports hand on: "expressions", "arkit" and "jaw", its (T, 3) axis-angles.
        is_good: (T,) whether the pose was tracked in the file.
    """

    positions: np.ndarray
    seconds: float
    fps: float
    kind: str
    up: str
    lower: LowerBody | None
    face: dict[str, np.ndarray]
    is_good: np.ndarray


def read_smplx(
    path: str | os.PathLike,
    skeleton: Skeleton,
    body: Body,
    *,
    fps: float | None,
    source_fps: float | None = None,
    unit: float | None = None,
    up: str | None = None,
) -> SmplxMotion:
    """Read the SMPL-X motion of a file as joints of a skeleton; `smplx_arrays` lists the layouts.

    The 55 local rotations of poses, relative to the T-pose with flat hands, are interpolated on the sphere and applied
    to the body, which is shaped by `betas` and moved by `trans` (T, 3), so that bones keep their lengths. Positions in
    metres are interpolated linearly.

    Args:
        path: path of a `.npz` file, of a `.npy` file of positions, or of the body poses of Embody 3D, beside whose
            folder are those of its other arrays.
        body: body to which poses are applied, the template or that of a model file.
        fps: frames per second of the result; None keeps those of the file.
        source_fps: frames per second of the file; None uses the rate stored in it as `mocap_frame_rate` or `fps`.
        unit: metres in one unit of positions and translations; None stands for metres.
        up: axis of the file that points up, one of `body.UPS`; None takes the one nearest to the mean spine.

    Raises:
        UserError: the file has no such arrays, wrong shapes, invalid values, or no frame rate.
    """
    path = pathlib.Path(path)
    check_regular(path, "a .npz of SMPL-X motion")
    arrays: dict[str, np.ndarray]
    if is_embody(path):
        arrays = read_embody(path, _MAX_BYTES)
    elif path.suffix.lower() == ".npy":
        arrays = dict(zip(POSITIONS, read_npz(path, max_bytes=_MAX_BYTES).values()))
    else:
        arrays = read_npz(path, max_bytes=_MAX_BYTES, names=NAMES)
    with naming(path):
        return to_motion(to_arrays(arrays, source_fps, unit), skeleton, body, fps=fps, up=up)


def to_motion(
    arrays: SmplxArrays, skeleton: Skeleton, body: Body, *, fps: float | None, up: str | None = None
) -> SmplxMotion:
    """Convert the arrays of a file to joints of a skeleton; see `read_smplx`.

    Raises:
        UserError: the motion is too long, or has no heading or no person's arms.
    """
    frames, rate = arrays.frames, arrays.fps
    if (minutes := len(frames) / rate / 60) > MAX_MINUTES:
        raise UserError(
            f"{minutes:.0f} minutes at {rate:g} frames per second; expected at most {MAX_MINUTES:.0f}: cut the file"
        )
    moments = moments_at(len(frames), rate, fps or rate)
    check_size(frames.shape[1], len(moments))
    face = {name: _between(values, moments).astype(np.float32) for name, values in arrays.face.items()}
    if arrays.are_poses:
        kind, rest = POSES, body.shaped(arrays.betas)
        points, rotations = _pose(frames, rest, moments)
        points += _between(arrays.trans, moments)[:, None]
        positions = _choose(points, skeleton)
        if arrays.is_own and up is None:
            up, axes = "y", np.diag(export_axes(skeleton))
            positions = add_rest_face(positions, rotations[HEAD].as_matrix(), skeleton)
        else:
            up = choose_up(positions, skeleton, up)
            axes = mean_heading(positions, skeleton, up=up)
        to_export = axes * export_axes(skeleton)
        lower = from_rest_pose(
            rest[_LOWER],
            np.stack([to_export.T @ rotations[joint].as_matrix() for joint in _LOWER], axis=1),
            points[:, 0] @ to_export,
            points[:, JOINTS.index(_CHEST)] @ to_export,
        )
        jaw = _between(frames[:, JOINTS.index("jaw")], moments)
        if jaw.any():
            face["jaw"] = jaw.astype(np.float32)
    else:
        axes, kind, lower = None, f"positions of {frames.shape[1]} joints", None
        positions, up = _from_positions(_between(frames, moments), skeleton, up)
    check_arms(arm_length(positions, skeleton, "left"), 1.0)
    positions = to_skeleton_axes(positions, skeleton, up=up, axes=axes).astype(np.float32)
    before, after, _ = _neighbours(moments, len(frames))
    is_good = arrays.is_good[before] & arrays.is_good[after]
    return SmplxMotion(positions, len(frames) / rate, rate, kind, up, lower, face, is_good)


def at_rate(arrays: SmplxArrays, fps: float, num_frames: int) -> SmplxArrays:
    """Return poses at another frame rate: rotations on the sphere, all else linearly; frame k shows the time k / fps.

    Poses that have the rate keep their values. After the last frame the last pose is held, up to `num_frames`.
    """
    last = len(arrays.frames) - 1
    if fps == arrays.fps:
        frames = np.minimum(np.arange(num_frames), last)
        face = {name: values[frames] for name, values in arrays.face.items()}
        return arrays._replace(frames=arrays.frames[frames], trans=arrays.trans[frames], face=face)
    moments = np.minimum(np.arange(num_frames) * (arrays.fps / fps), last)
    local = [_local(arrays.frames[:, joint], moments).as_rotvec() for joint in range(arrays.frames.shape[1])]
    face = {name: _between(values, moments).astype(np.float32) for name, values in arrays.face.items()}
    return arrays._replace(frames=np.stack(local, axis=1), trans=_between(arrays.trans, moments), fps=fps, face=face)


def joints_at_origin(arrays: SmplxArrays, rest: np.ndarray, fps: float) -> np.ndarray:
    """Return (T, 55, 3) metres of all joints without the translation, the pelvis where it is in the T-pose.

    Args:
        rest: (61, 3) points of the person in the T-pose.
        fps: frames per second of the result, which has the axes of the file.

    Raises:
        UserError: the motion is too long.
    """
    moments = moments_at(len(arrays.frames), arrays.fps, fps)
    check_size(len(JOINTS), len(moments))
    if arrays.are_poses:
        return _pose(arrays.frames, rest, moments)[0][:, : len(JOINTS)]
    places = _between(arrays.frames[:, : len(JOINTS)], moments)
    return places - places[:, :1] + rest[0]


def _neighbours(moments: np.ndarray, num_frames: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the frames (T,) before and after each moment, and the weight (T,) of the latter."""
    before = np.floor(moments).astype(int)
    return before, np.minimum(before + 1, num_frames - 1), moments - before


def _between(values: np.ndarray, moments: np.ndarray) -> np.ndarray:
    before, after, weight = _neighbours(moments, len(values))
    weight = weight.reshape(-1, *[1] * (values.ndim - 1))
    return values[before] + weight * (values[after] - values[before])


def _local(axis_angles: np.ndarray, moments: np.ndarray) -> Rotation:
    """Return the T rotations of one joint at the moments, on the sphere between its axis-angles (frames, 3)."""
    before, after, weight = _neighbours(moments, len(axis_angles))
    first, second = (Rotation.from_rotvec(axis_angles[frames]) for frames in (before, after))
    return first * Rotation.from_rotvec(weight[:, None] * (first.inv() * second).as_rotvec())


def _pose(axis_angles: np.ndarray, rest: np.ndarray, moments: np.ndarray) -> tuple[np.ndarray, list[Rotation]]:
    """Apply axis-angles (frames, 55, 3) to a body (61, 3) at T moments; return points (T, 61, 3) and rotations."""
    positions = np.empty((len(moments), len(rest), 3))
    positions[:, 0] = rest[0]
    rotations: list[Rotation] = []
    for joint, parent in enumerate(PARENTS):
        rotation = _local(axis_angles[:, joint], moments)
        rotations.append(rotation if parent < 0 else rotations[parent] * rotation)
    parents = (*PARENTS, *[HEAD] * (len(rest) - len(JOINTS)))
    for point, parent in enumerate(parents[1:], start=1):
        positions[:, point] = positions[:, parent] + rotations[parent].apply(rest[point] - rest[parent])
    return positions, rotations


def _from_positions(found: np.ndarray, skeleton: Skeleton, up: str | None) -> tuple[np.ndarray, str]:
    """Return the joints of the skeleton (T, joints, 3) from those of SMPL-X (T, 55 or more, 3), and the up axis."""
    has_face = found.shape[1] > len(JOINTS)
    count = len(JOINTS) + (len(FACE) - 1 if has_face else 0)
    points = np.zeros((len(found), len(JOINTS) + len(FACE), 3))
    points[:, :count] = found[:, :count]
    positions = _choose(points, skeleton)
    up = choose_up(positions, skeleton, up)
    positions_with_face = add_face(positions, points[:, HEAD], _head_rotations(points), skeleton, up=up)
    made = [joint in FACE and (joint == "head" or not has_face) for joint in skeleton.joints]
    positions[:, made] = positions_with_face[:, made]
    return positions, up


def _head_rotations(points: np.ndarray) -> np.ndarray:
    left, right = (points[:, JOINTS.index(f"{side}_eyeball")] for side in ("left", "right"))
    x, ahead = left - right, (left + right) / 2 - points[:, HEAD]
    y = np.cross(ahead, x)
    axes = np.stack([x, y, np.cross(x, y)], axis=-1)
    lengths = np.linalg.norm(axes, axis=1, keepdims=True)
    if (lengths == 0).any():
        frame = int(np.argmax((lengths == 0).any(axis=(1, 2)))) + 1
        raise UserError(f"the eyes and the head joint of frame {frame} lie on one line; repair this frame")
    return axes / lengths


def _choose(points: np.ndarray, skeleton: Skeleton) -> np.ndarray:
    places = {name: index for index, name in enumerate((*JOINTS, *FACE))} | {"spine": JOINTS.index(_CHEST)}
    return points[:, [places[joint] for joint in skeleton.joints]]
