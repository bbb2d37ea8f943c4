"""Validation of a motion before it is converted, drawn or exported."""

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.motion.motion import Motion
from ha2g_jax.skeleton import SKELETONS, load_skeleton

MAX_FRAMES = 1_000_000  # more than an hour at 240 frames per second; rotations take 2 GB
MAX_METRES = 100.0

_MIN_LENGTH = 1e-3  # least length of a direction vector, which should have length 1


def check(motion: Motion) -> None:
    """Check that a motion is valid.

    Args:
        motion: motion to check.

    Raises:
        UserError: the skeleton or the joints are unknown, the arrays do not fit together, there are no or too many
            frames, a value is not finite, a direction vector has length 0, or a position is too far away.
    """
    name = motion.meta.get("skeleton")
    if name not in SKELETONS:
        raise UserError(f"the motion has skeleton {str(name)[:40]!r}; expected {' or '.join(SKELETONS)}")
    skeleton = load_skeleton(name)
    if tuple(motion.joint_names) != skeleton.joints:
        pairs = zip(motion.joint_names, skeleton.joints, strict=False)
        first = next((f"{found!r} for {ours}" for found, ours in pairs if found != ours), "another number")
        raise UserError(
            f"the motion has {len(motion.joint_names)} joints, not the {skeleton.num_joints} of {name} ({first}); "
            "give one that ha2g generate wrote"
        )
    frames = len(motion.directions)
    for kind, array, count in (
        ("directions", motion.directions, skeleton.num_bones),
        ("positions", motion.positions, skeleton.num_joints),
    ):
        if array.shape != (frames, count, 3) or array.dtype.kind != "f":
            raise UserError(
                f"the motion's {kind} are {array.dtype} of shape {array.shape}; expected floats, {(frames, count, 3)}"
            )
    if not 1 <= frames <= MAX_FRAMES:
        raise UserError(
            f"the motion has {frames} frames; expected 1 to {MAX_FRAMES}: cut it, or generate at a lower frame rate"
        )
    if not (np.isfinite(motion.fps) and motion.fps > 0):
        raise UserError(f"the motion has {motion.fps} frames per second; expected a number above 0")
    _check_values(motion, [skeleton.joints[child] for _, child in skeleton.bones])


def _check_values(motion: Motion, ends: list[str]) -> None:
    for kind, array, names in (
        ("direction of the bone to", motion.directions, ends),
        ("position of", motion.positions, motion.joint_names),
    ):
        is_bad = ~np.isfinite(array).all(axis=-1)
        if is_bad.any():
            frame, index = np.argwhere(is_bad)[0]
            raise UserError(
                f"the {kind} {names[index]} in frame {frame} is not a number; expected finite values: generate the "
                "motion again"
            )
    is_short = np.linalg.norm(motion.directions.astype(np.float64), axis=-1) < _MIN_LENGTH
    if is_short.any():
        frame, bone = np.argwhere(is_short)[0]
        raise UserError(
            f"the bone to {ends[bone]} in frame {frame} has a direction of length 0; expected unit vectors: "
            "generate the motion again"
        )
    if (largest := float(np.abs(motion.positions).max())) > MAX_METRES:
        raise UserError(f"a joint of the motion is {largest:.4g} m away; expected metres, within {MAX_METRES:g}")
