"""How far a motion is from the one that was recorded. Errors of reconstruction: a good gesture may well be another."""

from typing import NamedTuple

import numpy as np

from ha2g_jax.skeleton import Skeleton, directions_to_positions, load_skeleton


class JointError(NamedTuple):
    """Mean absolute difference of joint coordinates, in metres and in mean bone lengths."""

    metres: float
    bone_lengths: float


class LegacyErrors(NamedTuple):
    """The two errors of the public release, in metres, and in metres per frame^2."""

    joint_mae: float
    acceleration: float


def joint_mae(skeleton: Skeleton, generated: np.ndarray, real: np.ndarray, *, first_frame: int = 4) -> JointError:
    """Mean |p_hat - p| over frames, joints (the root among them) and coordinates.

    Args:
        skeleton: of the directions.
        generated, real: (..., T, bones, 3) direction vectors, normalised here.
        first_frame: frames before it were given to the model and are not scored.

    Returns:
        The error; NaN where no frame is scored.
    """
    return _in_both_units(skeleton, _positions(skeleton, generated) - _positions(skeleton, real), first_frame)


def acceleration_error(
    skeleton: Skeleton, generated: np.ndarray, real: np.ndarray, fps: float, *, first_frame: int = 4
) -> JointError:
    """Mean |difference of the second differences of positions| x fps^2, over what `joint_mae` runs over.

    Args:
        skeleton: of the directions.
        generated, real: (..., T, bones, 3) direction vectors, normalised here.
        fps: frames per second.
        first_frame: frames before it were given to the model and are not scored.

    Returns:
        The error per s^2; NaN where fewer than 3 frames are scored.
    """
    difference = (_positions(skeleton, generated) - _positions(skeleton, real))[..., first_frame:, :, :]
    if difference.shape[-3] < 3:
        return JointError(np.nan, np.nan)
    return _in_both_units(skeleton, np.diff(difference, n=2, axis=-3) * fps**2, 0)


def legacy_errors(generated: np.ndarray, real: np.ndarray) -> LegacyErrors:
    """The errors as the public release computes them.

    Bones keep whatever length their vectors have, the bones are always TED-Gesture's (the first 9, whatever the
    skeleton), the joint error is of frames from the 5th on and the acceleration error of all.

    Args:
        generated, real: (n, T, bones, 3) vectors with the mean added, not normalised; bones >= 9, T >= 5.

    Returns:
        Means over everything; running means weighted by batch size come to the same.
    """
    skeleton = load_skeleton("ted_gesture")
    lengthened = (skeleton.paths * skeleton.lengths).astype(np.float64)
    first, second = (
        lengthened @ np.asarray(vectors, np.float64)[..., : skeleton.num_bones, :] for vectors in (generated, real)
    )
    difference = second - first
    return LegacyErrors(
        float(np.mean(np.abs(difference[:, 4:]))), float(np.mean(np.abs(np.diff(difference, n=2, axis=1))))
    )


def _positions(skeleton: Skeleton, directions: np.ndarray) -> np.ndarray:
    return directions_to_positions(skeleton, np.asarray(directions, np.float64))


def _in_both_units(skeleton: Skeleton, difference: np.ndarray, first_frame: int) -> JointError:
    scored = difference[..., first_frame:, :, :]
    metres = float(np.mean(np.abs(scored))) if scored.size else np.nan
    return JointError(metres, metres / float(np.mean(skeleton.lengths, dtype=np.float64)))
