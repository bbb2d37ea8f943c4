"""A motion in the layout of BEAT2, which is that of a submission: SMPL-X at 30 frames per second."""

import pathlib
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import shown
from ha2g_jax.motion import rigs, solver
from ha2g_jax.motion.formats.tables import arrays_of
from ha2g_jax.motion.lower_body import JOINTS as LOWER_JOINTS
from ha2g_jax.motion.lower_body import SOLE
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.readers import SMPLX, find_kind, joint_maps, read_content, read_motion, smplx, smplx_arrays
from ha2g_jax.motion.readers.smplx_arrays import NUM_SMPLH
from ha2g_jax.motion.readers.smplx_body import JOINTS, Body, template
from ha2g_jax.motion.resample import num_frames
from ha2g_jax.motion.rigs import retarget
from ha2g_jax.skeleton import load_skeleton

FPS = 30.0
NUM_BETAS, NUM_EXPRESSIONS, NUM_POSES = 300, 100, 3 * len(JOINTS)

WIDTHS = {"poses": NUM_POSES, "expressions": NUM_EXPRESSIONS, "trans": 3}
"""Values of a frame in each array of (T, values)."""

TEXTS = {"model": "smplx2020", "gender": "neutral"}
"""Facts of the body model."""

NAMES = ("betas", *WIDTHS, *TEXTS, "mocap_frame_rate")
"""Names of all arrays of a file."""

_MAX_DIFFERENCE = 1.0  # seconds between the ends of the motion of a file and of the speech
_FEET = [JOINTS.index(name) for name in LOWER_JOINTS if name.endswith(("ankle", "foot"))]


class Sample(NamedTuple):
    """A motion for the speech of one clip.

    Attributes:
        poses: (T, 165) float32 axis-angles in radians of the 55 joints, zero for the flat hand.
        expressions: (T, 100) float32 weights of the expressions of FLAME, zero without a face.
        trans: (T, 3) float32 metres, y up.
        betas: (300,) float32 shape of the body.
    """

    poses: np.ndarray
    expressions: np.ndarray
    trans: np.ndarray
    betas: np.ndarray

    def write(self, path: pathlib.Path) -> None:
        """Write the arrays of BEAT2 to an `.npz` file; the same sample gives the same bytes."""
        arrays: dict[str, Any] = self._asdict() | TEXTS | {"mocap_frame_rate": int(FPS)}
        np.savez_compressed(path, **arrays)


def from_motion(motion: Motion, count: int, *, betas: np.ndarray | None = None, body: Body | None = None) -> Sample:
    """Convert a motion.

    Pelvis, legs, place and face are those of the motion, where it has them; else the legs stand still.

    Args:
        motion: motion of at least one frame, at any frame rate.
        count: number of frames of the result.
        betas: (n,) shape of the body; zero by default.
        body: SMPL-X body model, with which the soles of a person who stands still touch the floor, y = 0, and `trans`
            is right for other motion; without it `trans` is the place of the pelvis, zero for one who stands still.

    Returns:
        The motion with `count` frames at 30 frames per second.
    """
    animation = retarget(solver.animate(motion), rigs.load_rig("smplx"))
    arrays = arrays_of(animation, moves=motion.lower is not None, face=motion.face)
    arrays |= {"mocap_frame_rate": np.array(motion.fps), "betas": np.zeros(0) if betas is None else betas}
    if body is not None:
        points = body.shaped(arrays["betas"])
        arrays["trans"] = arrays["trans"] - points[0].astype(np.float32)  # the pelvis is not at the model's origin
        if motion.lower is None:
            arrays["trans"][:, 1] += np.float32(points[0, 1] - points[_FEET, 1].min() + SOLE)
    return _sample(smplx.at_rate(smplx_arrays.to_arrays(arrays), FPS, count))


def from_file(
    path: pathlib.Path,
    count: int,
    *,
    betas: np.ndarray | None = None,
    body: Body | None = None,
    joint_map: str = joint_maps.AUTO,
    source_fps: float | None = None,
) -> Sample:
    """Read a motion of any kind; poses of SMPL-X with y up keep their values.

    Args:
        path: path of the file.
        count: number of frames of the result.
        betas: (n,) shape of the body, in place of that of the file.
        body: see `from_motion`.
        joint_map: see `motion.readers.read_motion`.
        source_fps: frames per second of a file that does not say it.

    Raises:
        UserError: the file cannot be read, or its length differs from that of the speech by more than a second.
    """
    content = read_content(path)
    if find_kind(content).name == SMPLX and smplx_arrays.has_poses(content.arrays):
        try:
            arrays = smplx_arrays.to_arrays(content.arrays, source_fps)
            up = smplx.to_motion(arrays, load_skeleton("ted_expressive"), template(), fps=1.0).up
        except UserError as error:
            raise UserError(f"{shown(path)}: {error}") from error
        betas = _own_betas(content.arrays, arrays) if betas is None else betas
        body = None  # `trans` is one of SMPL-X already
        if up == "y":
            _check_length(path, len(arrays.frames), arrays.fps, count)
            return _sample(smplx.at_rate(arrays._replace(betas=betas), FPS, count))
    motion = read_motion(path, joint_map=joint_map, source_fps=source_fps)
    _check_length(path, motion.num_frames, motion.fps, count)
    return from_motion(motion, count, betas=betas, body=body)


def read_betas(arrays: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the shape (300,) of the person of a file of SMPL-X motion.

    Raises:
        UserError: the file has no shape, or no numbers.
    """
    if "betas" not in arrays:
        raise UserError("no betas in it; expected a file of BEAT2")
    return _width(smplx_arrays.read_shape(arrays)[None], NUM_BETAS)[0]


def _own_betas(given: Mapping[str, np.ndarray], arrays: smplx_arrays.SmplxArrays) -> np.ndarray:
    """Return the shape of a file; that of SMPL-H belongs to another body model."""
    is_smplh = smplx_arrays.POSES in given and given[smplx_arrays.POSES].size == len(arrays.frames) * 3 * NUM_SMPLH
    return np.zeros(0) if is_smplh else arrays.betas


def _check_length(path: pathlib.Path, frames: int, fps: float, count: int) -> None:
    expected = num_frames(frames / fps, FPS)
    if abs(expected - count) > _MAX_DIFFERENCE * FPS:
        raise UserError(
            f"{shown(path)} lasts {frames / fps:.2f} s, and the speech {count / FPS:.2f} s; expected a difference of "
            f"at most {_MAX_DIFFERENCE:g} s: give the motion of this speech"
        )


def _sample(arrays: smplx_arrays.SmplxArrays) -> Sample:
    count = len(arrays.frames)
    face = arrays.face.get("expressions", np.zeros((count, 0)))
    return Sample(
        poses=arrays.frames.reshape(count, NUM_POSES).astype(np.float32),
        expressions=_width(face, NUM_EXPRESSIONS),
        trans=arrays.trans.astype(np.float32),
        betas=_width(arrays.betas[None], NUM_BETAS)[0],
    )


def _width(values: np.ndarray, width: int) -> np.ndarray:
    """Return the first coefficients, which matter most; what is missing is zero."""
    found = np.zeros((len(values), width), np.float32)
    found[:, : values.shape[1]] = values[:, :width]
    return found
