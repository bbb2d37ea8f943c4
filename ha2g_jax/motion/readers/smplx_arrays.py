"""Arrays of a file of SMPL-X motion, in any of the published layouts, checked and converted to one form.

| layout | arrays |
|---|---|
| BEAT2, EMAGE; AMASS for SMPL-X | `poses` (T, 165): root, body, jaw, eyes, left and right hand |
| AMASS for SMPL-H | `poses` (T, 156): root, body, left and right hand |
| parts as in AMASS | `root_orient` (T, 3), `pose_body` (T, 63), `pose_hand` (T, 90), `pose_jaw`, `pose_eye` |
| parts as in the smplx package | `global_orient`, `body_pose`, `left_hand_pose`, `right_hand_pose`, `jaw_pose` |
| Seamless Interaction, for SMPL-H | `smplh:global_orient` (T, 3), `smplh:body_pose` (T, 21, 3) and others, in cm |
| Embody 3D | a folder a part: PERSON/smplx_mesh_body_pose/CAPTURE.npy, PERSON/missing/CAPTURE.npy and others |
| positions of joints | `joints` (T, 55, 76, 127 or 144, 3) in metres |

Beside them: `trans` or `transl` (T, 3), `betas`, `mocap_frame_rate` or another name of the rate, and of the face
`expressions` (T, n) of FLAME and `arkit` (T, 52), and `is_good` (T,), 0 in frames that were not tracked. Seamless
Interaction and Embody 3D have 30 frames per second and do not say so in the files.
"""

import pathlib
import re
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.files.npz import read_npz
from ha2g_jax.limits import MAX_FACE_VALUES, MAX_MOTION_FPS, MAX_SMPLX_FRAMES, MIN_MOTION_FPS
from ha2g_jax.motion.motion import FACE
from ha2g_jax.motion.readers.smplx_body import JOINTS
from ha2g_jax.motion.rigs import load_rig

IS_GOOD = "is_good"
"""Array (T,) or (T, 1) of frames that can be used; others are 0."""

SEAMLESS_PREFIX = "smplh:"
SEAMLESS_NAME = re.compile(r"V\d+_S\d+_I\d+_(P\w+)")
"""Name of a recording of Seamless Interaction; the group is the speaker."""

_FPS = 30
_SEAMLESS = {"translation": "transl", "is_valid": IS_GOOD}
_CENTIMETRE = 0.01

_EMBODY_PREFIX = "smplx_mesh_"
_EMBODY_BODY = f"{_EMBODY_PREFIX}body_pose"
_EMBODY_PARTS = (
    *("body_pose", "global_orient", "left_hand_pose", "right_hand_pose", "jaw_pose", "leye_pose", "reye_pose"),
    *("transl", "betas"),
)
_EMBODY_GOOD = "missing"
POSES = "poses"
POSITIONS = ("joints", "joints3d", "joints_3d", "positions", "keypoints3d", "keypoints_3d")

NUM_SMPLH = 52
"""Joints of SMPL-H."""

# Joints only; with points of the face and tips of toes and fingers; with landmarks of the face.
NUM_POSITIONS = (55, 76, 127, 144)

_RIG = load_rig("smplx")
_JOINT_NAMES = "joint_names"
_BETAS = "betas"
_TRANS = ("trans", "transl")
_RATES = ("mocap_frame_rate", "mocap_framerate", "fps", "frame_rate")
_EXPRESSIONS, _ARKIT = ("expressions", "expression"), ("arkit",)
_MAX_VALUE = 1e4  # radians or metres
_MANY_TURNS = 4 * np.pi  # radians of the largest rotation in most frames, beyond which they are no radians
_FARTHEST = 1000.0  # metres that a person moves along an axis in a recording

# First joint and number of joints of each part, by the names that it may have.
_PARTS = {
    ("root_orient", "global_orient"): (0, 1),
    ("pose_body", "body_pose"): (1, 21),
    ("pose_jaw", "jaw_pose"): (22, 1),
    ("pose_eye",): (23, 2),
    ("leye_pose",): (23, 1),
    ("reye_pose",): (24, 1),
    ("pose_hand",): (25, 30),
    ("left_hand_pose",): (25, 15),
    ("right_hand_pose",): (40, 15),
}
_NEEDED = 2  # parts without which there is no motion: the root and the body
_SMPLH = (*range(22), *range(25, 55))  # joints of SMPL-H among those of SMPL-X

NAMES = (
    POSES,
    _BETAS,
    *_TRANS,
    *_RATES,
    *POSITIONS,
    *_EXPRESSIONS,
    *_ARKIT,
    IS_GOOD,
    _JOINT_NAMES,
    *(name for names in _PARTS for name in names),
    *(f"{SEAMLESS_PREFIX}{name}" for names in _PARTS for name in names),
    *(f"{SEAMLESS_PREFIX}{name}" for name in ("translation", "is_valid")),
)
"""Arrays of a file that are read."""


def from_seamless(arrays: Mapping[str, np.ndarray]) -> Mapping[str, np.ndarray]:
    """Rename the arrays of Seamless Interaction, with the translation in metres and the frame rate; leave others."""
    own = {name.removeprefix(SEAMLESS_PREFIX): it for name, it in arrays.items() if name.startswith(SEAMLESS_PREFIX)}
    if not own:
        return arrays
    renamed = {_SEAMLESS.get(name, name): array for name, array in own.items()}
    if "transl" in renamed and renamed["transl"].dtype.kind in "fiu":
        renamed["transl"] = renamed["transl"] * _CENTIMETRE
    return {"fps": np.array(_FPS)} | renamed


def is_embody(path: pathlib.Path) -> bool:
    """Return whether a file is the body poses of a person of Embody 3D."""
    return path.parent.name == _EMBODY_BODY and path.suffix == ".npy" and not path.name.startswith(".")


def read_embody(path: pathlib.Path, max_bytes: int) -> dict[str, np.ndarray]:
    """Read the arrays of a person of Embody 3D from the path of the body poses."""
    arrays = {"fps": np.array(_FPS)}
    folders = {f"{_EMBODY_PREFIX}{part}": part for part in _EMBODY_PARTS} | {_EMBODY_GOOD: IS_GOOD}
    for folder, name in folders.items():
        part = path.parent.parent / folder / path.name
        if part.is_file():
            arrays[name] = next(iter(read_npz(part, max_bytes=max_bytes).values()))
    return arrays


class SmplxArrays(NamedTuple):
    """Contents of a file of SMPL-X motion.

    Attributes:
        frames: (T, 55, 3) axis-angles in radians, or (T, 55 or more, 3) positions in metres.
        are_poses: whether the frames are axis-angles.
        trans: (T, 3) metres, zero by default.
        betas: (n,) shape coefficients.
        fps: frames per second.
        face: values by name, which exports hand on: "expressions" (T, n) and "arkit" (T, 52), those that the file has.
        is_good: (T,) whether a frame can be used.
        is_own: whether the poses are those that `ha2g export` writes, y up and facing +z.
    """

    frames: np.ndarray
    are_poses: bool
    trans: np.ndarray
    betas: np.ndarray
    fps: float
    face: dict[str, np.ndarray]
    is_good: np.ndarray
    is_own: bool = False


def has_poses(arrays: Mapping[str, object]) -> bool:
    """Return whether a file has SMPL-X poses, judged by the names of its arrays."""
    parts = list(_PARTS)[:_NEEDED]
    names = {name.removeprefix(SEAMLESS_PREFIX) for name in arrays}
    return POSES in arrays or all(not names.isdisjoint(part) for part in parts)


def to_arrays(
    arrays: Mapping[str, np.ndarray], source_fps: float | None = None, unit: float | None = None
) -> SmplxArrays:
    """Check the arrays of a file, see `NAMES`, and convert them to one form.

    Frames that are marked as bad hold the nearest good one, so that neither the axes nor the checks depend on them. The
    frame rate is `source_fps`, or by default the one of the file; `unit` is metres in one unit of places, 1 by default.

    Raises:
        UserError: there are no poses and no positions, or wrong shapes, invalid values or no frame rate.
    """
    arrays = _held(from_seamless(arrays))
    if has_poses(arrays):
        name, frames = _poses(arrays)
        if np.median(np.linalg.norm(frames, axis=-1).max(axis=1)) > _MANY_TURNS:
            raise UserError(f"{name} holds rotations of many turns, such as those in degrees; expected radians")
    else:
        name = next((name for name in POSITIONS if name in arrays), "")
        if not name:
            raise UserError(f"no array {POSES} or {POSITIONS[0]} in it; expected poses or joint positions of SMPL-X")
        frames = _positions(arrays[name], name) * (unit or 1.0)
    count = len(frames)
    trans = _trans(arrays, count, name) * (unit or 1.0)
    if np.ptp(trans, axis=0).max(initial=0) > _FARTHEST:
        raise UserError(f"the person moves more than {_FARTHEST:.0f} m; give the metres in one unit (--unit)")
    return SmplxArrays(
        frames=frames,
        are_poses=has_poses(arrays),
        trans=trans,
        betas=read_shape(arrays),
        fps=source_fps or _rate(arrays),
        face=_face(arrays, count, name),
        is_good=_good(arrays, count, name),
        is_own=name == POSES and np.array_equal(arrays.get(_JOINT_NAMES, ()), [joint.name for joint in _RIG.joints]),
    )


def _poses(arrays: Mapping[str, np.ndarray]) -> tuple[str, np.ndarray]:
    if POSES in arrays:
        array = arrays[POSES]
        widths = {len(JOINTS): range(len(JOINTS)), NUM_SMPLH: _SMPLH}
        flat = array.reshape(len(array), -1) if array.ndim in (2, 3) and len(array) else np.zeros((0, 0))
        if (array.ndim == 3 and array.shape[2] != 3) or flat.shape[1] not in (3 * width for width in widths):
            raise UserError(
                f"{POSES} has shape {array.shape}; expected (frames, {3 * len(JOINTS)}), three values for each of "
                f"{len(JOINTS)} joints, or (frames, {3 * NUM_SMPLH}) of SMPL-H"
            )
        values = _checked(flat, POSES).reshape(len(flat), -1, 3)
        poses = np.zeros((len(values), len(JOINTS), 3))
        poses[:, list(widths[values.shape[1]])] = values
        return POSES, poses
    first = next(name for name in next(iter(_PARTS)) if name in arrays)
    count = len(arrays[first]) if arrays[first].ndim else 0
    poses = np.zeros((count, len(JOINTS), 3))
    for names, (start, width) in _PARTS.items():
        for name in names:
            if name not in arrays:
                continue
            array = arrays[name]
            if not count or array.size != count * width * 3 or array.shape[0] != count:
                raise UserError(f"{name} has shape {array.shape}; expected {(count, 3 * width)}")
            poses[:, start : start + width] = _checked(array, name).reshape(count, width, 3)
    return first, poses


def _positions(array: np.ndarray, name: str) -> np.ndarray:
    if array.ndim != 3 or array.shape[2] != 3 or array.shape[1] not in NUM_POSITIONS or not len(array):
        expected = f"(frames, {' or '.join(map(str, NUM_POSITIONS))}, 3)"
        raise UserError(f"{name} has shape {array.shape}; expected {expected}")
    return _checked(array, name)


def _checked(array: np.ndarray, name: str) -> np.ndarray:
    """Return numbers of usual size as float64, the first axis being the frames."""
    if array.dtype.kind not in "fiu":
        raise UserError(f"{name} holds {array.dtype} instead of numbers; export the motion again")
    if len(array) > MAX_SMPLX_FRAMES:
        raise UserError(f"{name} has {len(array)} frames; expected at most {MAX_SMPLX_FRAMES}: cut the file")
    values = array.astype(np.float64)
    flat = values.reshape(len(values), -1)
    is_good = (flat.max(axis=1, initial=0) <= _MAX_VALUE) & (flat.min(axis=1, initial=0) >= -_MAX_VALUE)
    if not is_good.all():
        raise UserError(
            f"frame {int(np.argmin(is_good)) + 1} of {name} has values that are not finite or too large; repair it"
        )
    return values


def _rate(arrays: Mapping[str, np.ndarray]) -> float:
    name = next((name for name in _RATES if name in arrays), None)
    if name is None:
        raise UserError(f"no frame rate in it ({_RATES[0]}); give the frames per second (--source-fps)")
    value = arrays[name]
    try:  # some files have it as text, or once for each frame
        same = np.unique(value) if value.dtype.kind in "fiuSU" else ()
        rate = float(same[0]) if len(same) == 1 else 0.0
    except ValueError:
        rate = 0.0
    if not MIN_MOTION_FPS <= rate <= MAX_MOTION_FPS:
        raise UserError(f"{name} is {str(value)[:40]!r}; expected frames per second (--source-fps)")
    return rate


def read_shape(arrays: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the shape coefficients (n,), those of the first frame if a file has them for each frame."""
    betas = arrays.get(_BETAS, np.zeros(0))
    if betas.ndim == 2:
        betas = betas[0] if len(betas) else np.zeros(0)
    if betas.ndim != 1:
        raise UserError(f"{_BETAS} has shape {betas.shape}; expected a list of shape coefficients")
    return _checked(betas[None], _BETAS)[0]


def _trans(arrays: Mapping[str, np.ndarray], count: int, poses: str) -> np.ndarray:
    name = next((name for name in _TRANS if name in arrays), _TRANS[0])
    trans = arrays.get(name, np.zeros((count, 3)))
    if trans.shape != (count, 3):
        raise UserError(f"{name} has shape {trans.shape}; expected {(count, 3)}, as many frames as {poses}")
    return _checked(trans, name)


def _held(arrays: Mapping[str, np.ndarray]) -> Mapping[str, np.ndarray]:
    """Replace each bad frame of the arrays by the nearest good one; if no frame is good, return them unchanged."""
    marks = arrays.get(IS_GOOD)
    if marks is None or marks.dtype.kind not in "biuf" or not (good := np.flatnonzero(marks > 0)).size:
        return arrays
    after = np.minimum(np.searchsorted(good, np.arange(marks.size)), len(good) - 1)
    before = np.maximum(after - 1, 0)
    frames = np.arange(marks.size)
    is_nearer = np.abs(good[before] - frames) <= np.abs(good[after] - frames)
    nearest = np.where(is_nearer, good[before], good[after])
    return {
        name: array[nearest] if name != IS_GOOD and array.ndim > 1 and len(array) == marks.size else array
        for name, array in arrays.items()
    }


def _good(arrays: Mapping[str, np.ndarray], count: int, poses: str) -> np.ndarray:
    good = arrays.get(IS_GOOD, np.ones(count, bool))
    if good.size != count or good.dtype.kind not in "biuf":
        raise UserError(f"the marks of good frames have shape {good.shape}; expected {(count,)}, as many as {poses}")
    return good.reshape(count) > 0


def _face(arrays: Mapping[str, np.ndarray], count: int, poses: str) -> dict[str, np.ndarray]:
    face = {}
    for names in (_EXPRESSIONS, _ARKIT):
        width = FACE[names[0]]
        for name in names:
            array = arrays.get(name)
            if array is None:
                continue
            if array.ndim != 2 or len(array) != count or array.shape[1] > MAX_FACE_VALUES:
                raise UserError(
                    f"{name} has shape {array.shape}; expected ({count}, at most {MAX_FACE_VALUES}), as many frames "
                    f"as {poses}"
                )
            if width is not None and array.shape[1] != width:
                raise UserError(f"{name} has shape {array.shape}; expected {(count, width)}")
            face[names[0]] = _checked(array, name).astype(np.float32)
    return face
