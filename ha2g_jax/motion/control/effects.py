"""Application of controls: one pure function for each; with a neutral setting each returns its input."""

from collections.abc import Sequence

import numpy as np

from ha2g_jax.motion.control.controls import Controls, Pin, Span, check
from ha2g_jax.motion.control.parts import SIDES, arm_parts, bones_of, parts, rest_pose
from ha2g_jax.motion.control.scaling import reach_farther, scale_about, scale_about_mean
from ha2g_jax.motion.smoothing import minimum_jerk
from ha2g_jax.skeleton import Skeleton, mirror_directions

EASE = 0.5  # seconds of the transition from the motion to a pose, and of the transition back
POSTURE_SECONDS = 4.0  # window of the slow mean pose, which counts as posture and not as movement


def apply(skeleton: Skeleton, directions: np.ndarray, fps: float, controls: Controls) -> np.ndarray:
    """Apply controls to a motion: mirror, then scale, then hold the poses of pins and mutes.

    Args:
        skeleton: skeleton of the directions.
        directions: (T, bones, 3) float32 unit vectors.
        fps: frames per second; frame k shows the time k / fps.
        controls: controls to apply.

    Returns:
        (T, bones, 3) float32 unit vectors; the input itself for neutral controls.

    Raises:
        UserError: an amount, a side, a pose or a span is not valid.
    """
    check(controls, skeleton, (len(directions) + 0.5) / fps)  # the longest duration that rounds to so many frames
    directions = mirror(skeleton, directions, controls.mirror)
    directions = energy(skeleton, directions, fps, controls.energy)
    directions = extent(skeleton, directions, controls.extent)
    directions = handedness(skeleton, directions, controls.handedness)
    directions = pin(skeleton, directions, fps, controls.pins)
    return mute(skeleton, directions, fps, controls.mutes)


def energy(skeleton: Skeleton, directions: np.ndarray, fps: float, amount: float) -> np.ndarray:
    """Make a motion livelier or calmer by scaling the movement about its slow mean pose, and so the speed.

    The timing and the posture do not change; above 1 neither do the shapes of the hands.

    Args:
        skeleton: skeleton of the directions.
        directions: (T, bones, 3) unit vectors.
        fps: frames per second.
        amount: factor from 0, the slow mean pose over 4 seconds, to 2; 1 is the unchanged motion.

    Returns:
        (T, bones, 3) float32 unit vectors.
    """
    if amount == 1:
        return directions
    return scale_about_mean(skeleton, directions, fps, amount, POSTURE_SECONDS, parts(skeleton))


def extent(skeleton: Skeleton, directions: np.ndarray, amount: float) -> np.ndarray:
    """Make gestures larger or smaller by scaling the distance of the wrists from their rest position.

    Trunk and head do not change; above 1 neither do the hands relative to the forearms.

    Args:
        skeleton: skeleton of the directions.
        directions: (T, bones, 3) unit vectors.
        amount: factor from 0, both arms at rest, to 2; 1 is the unchanged motion.

    Returns:
        (T, bones, 3) float32 unit vectors.
    """
    if amount == 1:
        return directions
    if amount > 1:
        return reach_farther(skeleton, directions, amount)
    return scale_about(rest_pose(skeleton), directions, amount, arm_parts(skeleton))


def handedness(skeleton: Skeleton, directions: np.ndarray, side: str) -> np.ndarray:
    """Put one arm into the rest pose, so that only the other arm gestures.

    The arm that gestures, the trunk and the head do not change. For a motion that gestures with the other arm apply
    `mirror` first.

    Args:
        skeleton: skeleton of the directions.
        directions: (T, bones, 3) unit vectors.
        side: arm that gestures, "left" or "right", or "both" for the unchanged motion.

    Returns:
        (T, bones, 3) float32 unit vectors.
    """
    if side == "both":
        return directions
    (other,) = set(SIDES) - {side}
    bones = bones_of(arm_parts(skeleton, other))
    result = np.array(directions, np.float32)
    result[:, bones] = rest_pose(skeleton)[bones]
    return result


def mirror(skeleton: Skeleton, directions: np.ndarray, is_mirrored: bool = True) -> np.ndarray:
    """Exchange left and right in a motion.

    Args:
        skeleton: skeleton of the directions.
        directions: (T, bones, 3) unit vectors.
        is_mirrored: False for the unchanged motion.

    Returns:
        (T, bones, 3) unit vectors.
    """
    return mirror_directions(skeleton, directions) if is_mirrored else directions


def pin(skeleton: Skeleton, directions: np.ndarray, fps: float, pins: Sequence[Pin]) -> np.ndarray:
    """Make a motion hold poses of the whole body, or pass through them.

    More than half a second away from a pin the motion does not change.

    Args:
        skeleton: skeleton of the directions.
        directions: (T, bones, 3) unit vectors.
        fps: frames per second.
        pins: poses with their times, which do not overlap.

    Returns:
        (T, bones, 3) float32 unit vectors.
    """
    for one in pins:
        weight = motion_weight(one, [other for other in pins if other is not one], len(directions), fps)
        pose = rest_pose(skeleton) if one.pose is None else one.pose
        directions = scale_about(pose, directions, weight, parts(skeleton))
    return directions


def mute(skeleton: Skeleton, directions: np.ndarray, fps: float, mutes: Sequence[Span]) -> np.ndarray:
    """Remove gestures from spans of time: both arms rest, while trunk and head do not change.

    More than half a second away from a span the arms do not change either.

    Args:
        skeleton: skeleton of the directions.
        directions: (T, bones, 3) unit vectors.
        fps: frames per second.
        mutes: spans that do not overlap.

    Returns:
        (T, bones, 3) float32 unit vectors.
    """
    for one in mutes:
        weight = motion_weight(one, [other for other in mutes if other is not one], len(directions), fps)
        directions = scale_about(rest_pose(skeleton), directions, weight, arm_parts(skeleton))
    return directions


def motion_weight(span: Pin | Span, others: Sequence[Pin | Span], frames: int, fps: float) -> np.ndarray:
    """Compute the weight of the motion around a span: 0 within the span, 1 at least `EASE` seconds away from it.

    Start and end are rounded to the nearest frames. The weight follows a minimum-jerk curve in the transitions. A
    transition is not longer than the gap to the next span.

    Args:
        span: span in which the pose is held.
        others: other spans of the motion.
        frames: number of frames T.
        fps: frames per second.

    Returns:
        (T,) weights from 0 to 1.
    """
    first, last = (round(moment * fps) for moment in (span.start, span.end))
    gaps_before = [first - round(other.end * fps) for other in others if other.end <= span.start]
    gaps_after = [round(other.start * fps) - last for other in others if other.start >= span.end]
    eases = [max(1.0, min([EASE * fps, *gaps])) for gaps in (gaps_before, gaps_after)]
    frame = np.arange(frames)
    away = np.maximum(np.maximum((first - frame) / eases[0], (frame - last) / eases[1]), 0)
    return minimum_jerk(np.minimum(away, 1))
