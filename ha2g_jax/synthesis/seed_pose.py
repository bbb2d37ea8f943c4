"""Seed poses that the user chooses, from which a motion starts."""

import pathlib

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.resample import sample, slerp
from ha2g_jax.skeleton import Skeleton

SeedPose = str | pathlib.Path | Motion | np.ndarray

_MIN_LENGTH = 1e-6  # length below which a vector has no direction


def read_seed_pose(source: SeedPose, skeleton: Skeleton, fps: float, count: int) -> tuple[np.ndarray, str]:
    """Return a seed pose for a model, and its name for the metadata of the motion.

    Args:
        source: motion, or the path of its `.npz`, whose last frames are used; a pose (bones, 3); or poses
            (F, bones, 3) at `fps`, the last of which are used.
        skeleton: skeleton of the model.
        fps: frames per second of the model.
        count: number of frames of a seed pose, M; if the source is shorter, its first pose is repeated.

    Returns:
        (M, bones, 3) float32 unit vectors, and the name.

    Raises:
        UserError: there is no such file, it has another skeleton, or a vector has no direction.
    """
    name, rate = "array", fps
    if isinstance(source, str | pathlib.Path):
        name = pathlib.Path(source).name
        source = Motion.load(source)
    if isinstance(source, Motion):
        name = name if name != "array" else "motion"
        if source.meta["skeleton"] != skeleton.name:
            raise UserError(
                f"the seed pose {name} is of the skeleton {source.meta['skeleton']}, the model of {skeleton.name}; "
                "give a motion on the skeleton of the model"
            )
        source, rate = source.directions, source.fps
    poses = np.asarray(source)
    poses = poses[None] if poses.ndim == 2 else poses
    if poses.ndim != 3 or not len(poses) or poses.shape[1:] != (skeleton.num_bones, 3):
        raise UserError(
            f"the seed pose {name} has the shape {poses.shape}; expected ({skeleton.num_bones}, 3) direction vectors "
            f"of {skeleton.name}, or (frames, {skeleton.num_bones}, 3)"
        )
    lengths = np.linalg.norm(poses.astype(np.float64), axis=-1, keepdims=True)
    if not (np.isfinite(lengths).all() and lengths.min() > _MIN_LENGTH):
        raise UserError(f"the seed pose {name} has vectors that are not finite or of no length; give another pose")
    places = len(poses) - 1 - np.arange(count)[::-1] * (rate / fps)
    return sample(poses / lengths, places), name


def start_from(directions: np.ndarray, seed: np.ndarray) -> np.ndarray:
    """Blend a seed pose into the first frames of a motion, so that frame 0 is that of the seed pose.

    Args:
        directions: (T, bones, 3) unit vectors of the motion.
        seed: (M, bones, 3) unit vectors of the seed pose.

    Returns:
        (T, bones, 3) float32 unit vectors.
    """
    count = min(len(seed), len(directions))
    weight = (np.arange(count, dtype=np.float32) / len(seed))[:, None, None]
    return np.concatenate([slerp(seed[:count], directions[:count], weight), directions[count:]]).astype(np.float32)
