"""The controls one by one: pure functions of direction vectors (T, bones, 3); the input itself if nothing is asked."""

from collections.abc import Sequence

import numpy as np

from ha2g_jax.motion.control.parts import SIDES, arm_parts, bones_of, parts, rest_pose
from ha2g_jax.motion.control.reach import reach_farther
from ha2g_jax.motion.control.scaling import scale_about, scale_about_mean
from ha2g_jax.motion.control.spans import Pin, Span, own_share
from ha2g_jax.skeleton import Skeleton, mirror_directions

POSTURE_SECONDS = 4.0  # what is slower than this is posture, not movement


def energy(skeleton: Skeleton, directions: np.ndarray, fps: float, amount: float) -> np.ndarray:
    """Livelier or calmer: every movement about the slow mean pose, scaled, and so its speed.

    When things happen, and the posture that the body moves about, stay; so do hand shapes for an amount above 1.

    Args:
        skeleton: of the directions.
        directions: (T, bones, 3) unit vectors.
        fps: frames per second.
        amount: 0 leaves the slow mean pose (over 4 seconds), 1 is the motion, 2 the most.
    """
    if amount == 1:
        return directions
    return scale_about_mean(skeleton, directions, fps, amount, POSTURE_SECONDS, parts(skeleton))


def extent(skeleton: Skeleton, directions: np.ndarray, amount: float) -> np.ndarray:
    """Larger or smaller gestures: how far the wrists are from where they rest, scaled.

    Trunk and head stay; so do the hands on their wrists for an amount above 1.

    Args:
        skeleton: of the directions.
        directions: (T, bones, 3) unit vectors.
        amount: 0 leaves both arms at rest, 1 is the motion, 2 the most.
    """
    if amount == 1:
        return directions
    if amount > 1:
        return reach_farther(skeleton, directions, amount)
    return scale_about(rest_pose(skeleton), directions, amount, arm_parts(skeleton))


def handedness(skeleton: Skeleton, directions: np.ndarray, side: str) -> np.ndarray:
    """Gestures with the "left" or the "right" arm alone, while the other rests; with "both" as they are.

    The arm that gestures, trunk and head stay. A motion that gestures with the other arm wants `mirror` before.
    """
    if side == "both":
        return directions
    (other,) = set(SIDES) - {side}
    bones = bones_of(arm_parts(skeleton, other))
    result = np.array(directions, np.float32)
    result[:, bones] = rest_pose(skeleton)[bones]
    return result


def mirror(skeleton: Skeleton, directions: np.ndarray, wanted: bool = True) -> np.ndarray:
    """The motion as a mirror shows it: what the left hand did, the right hand does."""
    return mirror_directions(skeleton, directions) if wanted else directions


def pin(skeleton: Skeleton, directions: np.ndarray, fps: float, pins: Sequence[Pin]) -> np.ndarray:
    """Poses of the whole body that the motion holds, or passes through.

    Args:
        skeleton: of the directions.
        directions: (T, bones, 3) unit vectors.
        fps: frames per second.
        pins: holds that do not overlap; half a second before and after each, the motion is its own.
    """
    for one in pins:
        share = own_share(one, [other for other in pins if other is not one], len(directions), fps)
        pose = rest_pose(skeleton) if one.pose is None else one.pose
        directions = scale_about(pose, directions, share, parts(skeleton))
    return directions


def mute(skeleton: Skeleton, directions: np.ndarray, fps: float, mutes: Sequence[Span]) -> np.ndarray:
    """Spans without gestures: both arms rest, while trunk and head go on.

    Args:
        skeleton: of the directions.
        directions: (T, bones, 3) unit vectors.
        fps: frames per second.
        mutes: spans that do not overlap; half a second before and after each, the arms are their own.
    """
    for one in mutes:
        share = own_share(one, [other for other in mutes if other is not one], len(directions), fps)
        directions = scale_about(rest_pose(skeleton), directions, share, arm_parts(skeleton))
    return directions
