"""Reader of SMPL-X motion as joints of a skeleton: axis-angle poses (BEAT2) or positions of joints (ExPose)."""

import os
import pathlib
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from ha2g_jax.data.mocap.axes import find_up, to_skeleton_axes
from ha2g_jax.data.mocap.face import add_face
from ha2g_jax.data.mocap.kinematics import check_size
from ha2g_jax.data.mocap.smplx_template import FACE, HEAD, JOINTS, PARENTS, Body
from ha2g_jax.errors import UserError
from ha2g_jax.files.npz import read_npz
from ha2g_jax.files.reading import check_regular, shown
from ha2g_jax.limits import MAX_MOTION_FPS, MAX_SMPLX_FRAMES, MAX_SOUND_SECONDS, MIN_MOTION_FPS
from ha2g_jax.skeleton import Skeleton

AUTO = "auto"

_MAX_BYTES = 1 << 28
_MAX_MINUTES = 2 * MAX_SOUND_SECONDS / 60  # length of a motion: audio must have at least half the length of its motion
_POSES, _BETAS, _TRANS = "poses", "betas", "trans"
_RATES = ("mocap_frame_rate", "mocap_framerate", "fps", "frame_rate")
_POSITIONS = ("joints", "joints3d", "joints_3d", "positions", "keypoints3d", "keypoints_3d")
# Joints only; with points of the face and tips of toes and fingers; with landmarks of the face.
_NUM_POSITIONS = (55, 76, 127, 144)
_MAX_VALUE = 1e4  # radians or metres
_ARM_RANGE = (0.3, 1.0)  # metres from shoulder to wrist

_CHEST = "spine3"  # joint used as `spine` of the skeletons, whose trunk is the bone from here to the neck


class SmplxMotion(NamedTuple):
    """The motion of a file, and how the file was interpreted.

    Attributes:
        positions: (T, joints, 3) metres in the skeleton's axes, float32.
        seconds: length of the motion in seconds.
        kind: "poses" or "positions of N joints".
        up: axis of the file that points up.
    """

    positions: np.ndarray
    seconds: float
    kind: str
    up: str


def read_smplx(
    path: str | os.PathLike,
    skeleton: Skeleton,
    body: Body,
    *,
    fps: float,
    source_fps: float | None = None,
    up: str = AUTO,
) -> SmplxMotion:
    """Read the SMPL-X motion of a file as joints of a skeleton.

    If the file has an array `poses` (T, 165), its 55 local rotations, relative to the T-pose with flat hands, are
    interpolated on the sphere and applied to the body, which is shaped by `betas` and moved by `trans` (T, 3), so that
    bones keep their lengths. Otherwise the positions (T, 55, 76, 127 or 144, 3) in metres of an array such as `joints`
    are interpolated linearly.

    Args:
        path: path of a `.npz` file, or of a `.npy` file of positions.
        skeleton: skeleton of the result.
        body: body to which poses are applied, the template or that of a model file.
        fps: frames per second of the result.
        source_fps: frames per second of the file; None uses the rate stored in it as `mocap_frame_rate` or `fps`.
        up: axis of the file that points up, one of `axes.UPS`; "auto" takes the one nearest to the mean spine.

    Raises:
        UserError: the file has no such arrays, wrong shapes, invalid values, or no frame rate.
    """
    path = pathlib.Path(path)
    check_regular(path, "a .npz of SMPL-X motion")
    if path.suffix.lower() == ".npy":
        arrays: dict[str, np.ndarray] = dict(zip(_POSITIONS, read_npz(path, max_bytes=_MAX_BYTES).values()))
    else:
        arrays = read_npz(path, max_bytes=_MAX_BYTES, names=(_POSES, _BETAS, _TRANS, *_RATES, *_POSITIONS))
    try:
        return _to_motion(arrays, skeleton, body, fps, source_fps, up)
    except UserError as error:
        raise UserError(f"{shown(path)}: {error}") from error


def _to_motion(
    arrays: Mapping[str, np.ndarray], skeleton: Skeleton, body: Body, fps: float, source_fps: float | None, up: str
) -> SmplxMotion:
    name = next((name for name in (_POSES, *_POSITIONS) if name in arrays), None)
    if name is None:
        raise UserError(f"no array {_POSES} or {_POSITIONS[0]} in it; expected poses or joint positions of SMPL-X")
    frames = _check_frames(arrays[name], name)
    rate = source_fps or _frame_rate(arrays)
    if (minutes := len(frames) / rate / 60) > _MAX_MINUTES:
        raise UserError(
            f"{minutes:.0f} minutes at {rate:g} frames per second; expected at most {_MAX_MINUTES:.0f}: cut the file"
        )
    moments = _moments(len(frames), rate, fps)
    check_size(frames.shape[1], len(moments))
    if name == _POSES:
        kind, points = _POSES, _pose(frames, body.shaped(_shape(arrays)), moments)
        points += _between(_translation(arrays, len(frames)), moments)[:, None]
        positions = _choose(points, skeleton)
        up = find_up(positions, skeleton) if up == AUTO else up
    else:
        kind = f"positions of {frames.shape[1]} joints"
        positions, up = _from_positions(_between(frames, moments), skeleton, up)
    _check_arms(positions, skeleton)
    positions = to_skeleton_axes(positions, skeleton, up=up).astype(np.float32)
    return SmplxMotion(positions, len(frames) / rate, kind, up)


def _check_frames(array: np.ndarray, name: str) -> np.ndarray:
    """Check and return (T, 55, 3) axis-angles or (T, 55 or more, 3) positions as float64."""
    if name == _POSES:
        is_good = array.shape[1:] in ((3 * len(JOINTS),), (len(JOINTS), 3))
        expected = f"(frames, {3 * len(JOINTS)}), three values for each of {len(JOINTS)} joints"
    else:
        is_good = array.ndim == 3 and array.shape[2] == 3 and array.shape[1] in _NUM_POSITIONS
        expected = f"(frames, {' or '.join(map(str, _NUM_POSITIONS))}, 3)"
    if not is_good or not len(array):
        raise UserError(f"{name} has shape {array.shape}; expected {expected}")
    if len(array) > MAX_SMPLX_FRAMES:
        raise UserError(f"{name} has {len(array)} frames; expected at most {MAX_SMPLX_FRAMES}: cut the file")
    return _check_values(array, name).reshape(len(array), -1, 3)


def _check_values(array: np.ndarray, name: str) -> np.ndarray:
    if array.dtype.kind not in "fiu":
        raise UserError(f"{name} holds {array.dtype} instead of numbers; export the motion again")
    values = array.astype(np.float64)
    flat = values.reshape(len(values), -1)
    is_good = (flat.max(axis=1, initial=0) <= _MAX_VALUE) & (flat.min(axis=1, initial=0) >= -_MAX_VALUE)
    if not is_good.all():
        raise UserError(
            f"frame {int(np.argmin(is_good)) + 1} of {name} has values that are not finite or too large; repair it"
        )
    return values


def _frame_rate(arrays: Mapping[str, np.ndarray]) -> float:
    name = next((name for name in _RATES if name in arrays), None)
    if name is None:
        raise UserError(f"no frame rate in it ({_RATES[0]}); give the frames per second (--source-fps)")
    value = arrays[name]
    rate = float(value.reshape(-1)[0]) if value.size == 1 and value.dtype.kind in "fiu" else 0.0
    if not MIN_MOTION_FPS <= rate <= MAX_MOTION_FPS:
        raise UserError(f"{name} is {str(value)[:40]!r}; expected frames per second (--source-fps)")
    return rate


def _shape(arrays: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the shape coefficients (n,), those of the first frame if a file has them for each frame."""
    betas = arrays.get(_BETAS, np.zeros(0))
    betas = betas[0] if betas.ndim == 2 and len(betas) else betas
    if betas.ndim != 1:
        raise UserError(f"{_BETAS} has shape {betas.shape}; expected a list of shape coefficients")
    return _check_values(betas[None], _BETAS)[0]


def _translation(arrays: Mapping[str, np.ndarray], num_frames: int) -> np.ndarray:
    trans = arrays.get(_TRANS, np.zeros((num_frames, 3)))
    if trans.shape != (num_frames, 3):
        raise UserError(f"{_TRANS} has shape {trans.shape}; expected {(num_frames, 3)}, as many frames as {_POSES}")
    return _check_values(trans, _TRANS)


def _moments(num_frames: int, source_fps: float, fps: float) -> np.ndarray:
    """Return the fractional frames (T,) of the file at which poses are sampled."""
    last = num_frames - 1
    return np.minimum(np.arange(int(last * fps / source_fps + 1e-6) + 1) * (source_fps / fps), last)


def _neighbours(moments: np.ndarray, num_frames: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the frames (T,) before and after each moment, and the weight (T,) of the latter."""
    before = np.floor(moments).astype(int)
    return before, np.minimum(before + 1, num_frames - 1), moments - before


def _between(values: np.ndarray, moments: np.ndarray) -> np.ndarray:
    before, after, weight = _neighbours(moments, len(values))
    weight = weight.reshape(-1, *[1] * (values.ndim - 1))
    return values[before] + weight * (values[after] - values[before])


def _pose(axis_angles: np.ndarray, rest: np.ndarray, moments: np.ndarray) -> np.ndarray:
    """Apply local axis-angles (frames, 55, 3) to a body (61, 3) and return its points (T, 61, 3) at the moments."""
    before, after, weight = _neighbours(moments, len(axis_angles))
    positions = np.empty((len(moments), len(rest), 3))
    positions[:, 0] = rest[0]
    rotations: list[Rotation] = []
    for joint, parent in enumerate(PARENTS):
        first, second = (Rotation.from_rotvec(axis_angles[frames, joint]) for frames in (before, after))
        rotation = first * Rotation.from_rotvec(weight[:, None] * (first.inv() * second).as_rotvec())
        rotations.append(rotation if parent < 0 else rotations[parent] * rotation)
    parents = (*PARENTS, *[HEAD] * (len(rest) - len(JOINTS)))
    for point, parent in enumerate(parents[1:], start=1):
        positions[:, point] = positions[:, parent] + rotations[parent].apply(rest[point] - rest[parent])
    return positions


def _from_positions(found: np.ndarray, skeleton: Skeleton, up: str) -> tuple[np.ndarray, str]:
    """Return the joints of the skeleton (T, joints, 3) from those of SMPL-X (T, 55 or more, 3), and the up axis."""
    has_face = found.shape[1] > len(JOINTS)
    count = len(JOINTS) + (len(FACE) - 1 if has_face else 0)
    points = np.zeros((len(found), len(JOINTS) + len(FACE), 3))
    points[:, :count] = found[:, :count]
    positions = _choose(points, skeleton)
    up = find_up(positions, skeleton) if up == AUTO else up
    positions_with_face = add_face(positions, points[:, HEAD], _head_rotations(points), skeleton, up=up)
    made = [joint in FACE and (joint == "head" or not has_face) for joint in skeleton.joints]
    positions[:, made] = positions_with_face[:, made]
    return positions, up


def _head_rotations(points: np.ndarray) -> np.ndarray:
    """Return rotations (T, 3, 3) of the head, computed from its joint and the eyeballs."""
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
    """Select the joints of the skeleton (T, joints, 3) from points (T, 61, 3)."""
    places = {name: index for index, name in enumerate((*JOINTS, *FACE))} | {"spine": JOINTS.index(_CHEST)}
    return points[:, [places[joint] for joint in skeleton.joints]]


def _check_arms(positions: np.ndarray, skeleton: Skeleton) -> None:
    arm = [skeleton.joint(f"left_{part}") for part in ("shoulder", "elbow", "wrist")]
    length = float(np.median(np.linalg.norm(np.diff(positions[:, arm], axis=1), axis=-1).sum(axis=-1)))
    if not _ARM_RANGE[0] <= length <= _ARM_RANGE[1]:
        raise UserError(f"the left arm is {length:.4g} long from shoulder to wrist; expected metres, about 0.55")
