"""SMPL-X poses in a numpy `.npz` with the field names of AMASS and BEAT2."""

import pathlib

import numpy as np

from ha2g_jax.files.whole_file import whole_file
from ha2g_jax.motion import rotations
from ha2g_jax.motion.armature import Animation

_NUM_BETAS = 16


def write(path: str | pathlib.Path, animation: Animation) -> None:
    """Write the poses of an animation of the rig smplx.

    Fields: `poses` (T, 165) float32, axis-angle vectors in radians of the 55 joints, each relative to its parent, with
    zero for the flat hand (flat_hand_mean=True); hips, legs, jaw and eyes are zero. `trans` (T, 3) float32 metres,
    zero, y up, facing +z. `betas` (16,) zero, the mean shape. `mocap_frame_rate` frames per second, `gender`
    "neutral", `surface_model_type` "smplx", `joint_names` (55,).

    Args:
        path: file to write.
        animation: animation of the rig smplx.

    Raises:
        UserError: the file cannot be written.
    """
    vectors = rotations.to_vector(animation.rotations)
    frames = animation.num_frames
    with whole_file(path) as temporary, temporary.open("wb") as file:
        np.savez(
            file,
            poses=vectors.reshape(frames, -1).astype(np.float32),
            trans=np.zeros((frames, 3), np.float32),
            betas=np.zeros(_NUM_BETAS, np.float32),
            mocap_frame_rate=np.float64(animation.fps),
            gender=np.array("neutral"),
            surface_model_type=np.array("smplx"),
            joint_names=np.array(animation.armature.joints),
        )
