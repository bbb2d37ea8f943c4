"""The poses that a motion starts from when the user gives them."""

import pathlib

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.resample import sample, slerp
from ha2g_jax.skeleton import Skeleton

SeedPose = str | pathlib.Path | Motion | np.ndarray

_MIN_LENGTH = 1e-6  # of a direction vector


def read_seed_pose(source: SeedPose, skeleton: Skeleton, fps: float, count: int) -> tuple[np.ndarray, str]:
    """The seed pose for the model, and its name for the record.

    Args:
        source: a motion or its `.npz`, whose last frames are taken; a pose (bones, 3) to start from; or poses
            (F, bones, 3) at `fps`, the last of which are taken.
        skeleton: of the model.
        fps: frames per second of the model.
        count: M, frames of a seed pose; of a shorter motion the first pose is held before it.

    Returns:
        (M, bones, 3) float32 unit vectors.

    Raises:
        UserError: no such file, another skeleton, or vectors without a direction.
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
                "give a motion of the model's skeleton"
            )
        source, rate = source.directions, source.fps
    poses = np.asarray(source)
    poses = poses[None] if poses.ndim == 2 else poses
    if poses.ndim != 3 or not len(poses) or poses.shape[1:] != (skeleton.num_bones, 3):
        raise UserError(
            f"the seed pose {name} has the shape {poses.shape}; expected ({skeleton.num_bones}, 3) direction vectors "
            f"of {skeleton.name}, or frames of them"
        )
    lengths = np.linalg.norm(poses.astype(np.float64), axis=-1, keepdims=True)
    if not (np.isfinite(lengths).all() and lengths.min() > _MIN_LENGTH):
        raise UserError(f"the seed pose {name} has vectors that are not finite or of no length; give another")
    places = len(poses) - 1 - np.arange(count)[::-1] * (rate / fps)
    return sample(poses / lengths, places), name


def start_from(directions: np.ndarray, seed: np.ndarray) -> np.ndarray:
    """The motion (T, bones, 3) with the seed pose (M, bones, 3) faded into its first frames: frame 0 is the seed's."""
    count = min(len(seed), len(directions))
    share = (np.arange(count, dtype=np.float32) / len(seed))[:, None, None]
    return np.concatenate([slerp(seed[:count], directions[:count], share), directions[count:]]).astype(np.float32)
