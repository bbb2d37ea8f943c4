"""SMPL-X poses in a numpy `.npz` with the field names of AMASS and BEAT2."""

import pathlib
from collections.abc import Mapping
from typing import Any

import numpy as np

from ha2g_jax.files.writing import whole_file
from ha2g_jax.motion import rotations
from ha2g_jax.motion.armature import Animation

_NUM_BETAS = 16


def write(
    path: str | pathlib.Path,
    animation: Animation,
    *,
    moves: bool = False,
    face: Mapping[str, np.ndarray] | None = None,
) -> None:
    """Write the poses of an animation of the rig smplx.

    Fields: `poses` (T, 165) float32, axis-angle vectors in radians of the 55 joints, each relative to its parent, with
    zero for the flat hand (flat_hand_mean=True); hips and legs are zero unless the motion has them, jaw and eyes are
    zero but for the jaw of `face`. `trans` (T, 3) float32 metres, zero unless the person moves, y up, facing +z.
    `betas` (16,) zero, the mean shape. `mocap_frame_rate` frames per second, `gender` "neutral", `surface_model_type`
    "smplx", `joint_names` (55,). `expressions` (T, n) and `arkit` (T, 52) of `face`, where it has them.

    Args:
        path: file to write.
        animation: animation of the rig smplx.
        moves: whether the root of the animation moves, so that its place is `trans`.
        face: passengers of the motion, see `Motion.face`.

    Raises:
        UserError: the file cannot be written.
    """
    with whole_file(path) as temporary, temporary.open("wb") as file:
        np.savez(
            file,
            **arrays_of(animation, moves=moves, face=face or {}),
            betas=np.zeros(_NUM_BETAS, np.float32),
            mocap_frame_rate=np.float64(animation.fps),
            gender=np.array("neutral"),
            surface_model_type=np.array("smplx"),
            joint_names=np.array(animation.armature.joints),
        )


def arrays_of(animation: Animation, *, moves: bool, face: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Return the arrays of a file that change over time.

    Args:
        animation: animation of the rig smplx.
        moves: whether the root of the animation moves, so that its place is `trans`.
        face: passengers of the motion, see `Motion.face`.

    Returns:
        `poses` (T, 165) and `trans` (T, 3) float32, and those of `face` but the jaw, which is in the poses.
    """
    vectors, frames = rotations.to_vector(animation.rotations), animation.num_frames
    if "jaw" in face:
        vectors[:, animation.armature.joint("jaw")] = face["jaw"]
    return {
        "poses": vectors.reshape(frames, -1).astype(np.float32),
        "trans": animation.translation.astype(np.float32) if moves else np.zeros((frames, 3), np.float32),
        **{name: values for name, values in face.items() if name != "jaw"},
    }
