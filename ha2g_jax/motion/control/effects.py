"""Application of controls, one pure function for each, and of controls that change during an ongoing motion.

With a neutral setting each function returns its input. Directions are (T, bones, 3) float32 unit vectors, in and out;
frame k shows the time k / fps.
"""

import copy
import math
from collections.abc import Sequence

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.motion.control.controls import NEUTRAL, Controls, Pin, Span, check
from ha2g_jax.motion.control.parts import (
    SIDES,
    arm_parts,
    bones_of,
    parts,
    reach_farther,
    rest_pose,
    scale_about,
    scale_about_mean,
    scale_about_posture,
)
from ha2g_jax.motion.smoothing import minimum_jerk, to_unit
from ha2g_jax.skeleton import Skeleton, mirror_directions

EASE = 0.5  # seconds of the transition from the motion to a pose, and of the transition back
_POSTURE_SECONDS = 4.0  # window of the slow mean pose, which counts as posture and not as movement
_RUNNING_SECONDS = _POSTURE_SECONDS / 2  # time constant of the mean of the poses so far


def apply(skeleton: Skeleton, directions: np.ndarray, fps: float, controls: Controls) -> np.ndarray:
    """Apply controls to a motion: mirror, then scale, then hold the poses of pins and mutes.

    Raises:
        UserError: an amount, a side, a pose or a span is not valid.
    """
    return hold(skeleton, change(skeleton, directions, fps, controls), fps, controls)


def change(skeleton: Skeleton, directions: np.ndarray, fps: float, controls: Controls) -> np.ndarray:
    """Apply the first part of `apply`: mirror, energy, extent and handedness."""
    check(controls, skeleton, (len(directions) + 0.5) / fps)  # the longest duration that rounds to so many frames
    directions = mirror_directions(skeleton, directions) if controls.mirror else directions
    directions = energy(skeleton, directions, fps, controls.energy)
    directions = extent(skeleton, directions, controls.extent)
    return handedness(skeleton, directions, controls.handedness)


def hold(skeleton: Skeleton, directions: np.ndarray, fps: float, controls: Controls) -> np.ndarray:
    """Apply the second part of `apply`: pins and mutes."""
    directions = pin(skeleton, directions, fps, controls.pins)
    return mute(skeleton, directions, fps, controls.mutes)


def energy(skeleton: Skeleton, directions: np.ndarray, fps: float, amount: float) -> np.ndarray:
    """Make a motion livelier or calmer by scaling the movement about its slow mean pose, and so the speed.

    The timing and the posture do not change; above 1 neither do the shapes of the hands. The amount is a factor from 0,
    the slow mean pose over 4 seconds, to 2.
    """
    if amount == 1:
        return directions
    return scale_about_mean(skeleton, directions, fps, amount, _POSTURE_SECONDS, parts(skeleton))


def extent(skeleton: Skeleton, directions: np.ndarray, amount: float) -> np.ndarray:
    """Make gestures larger or smaller by scaling the distance of the wrists from their rest position.

    Trunk and head do not change; above 1 neither do the hands relative to the forearms. The amount is a factor from 0,
    both arms at rest, to 2.
    """
    if amount == 1:
        return directions
    if amount > 1:
        return reach_farther(skeleton, directions, amount)
    return scale_about(rest_pose(skeleton), directions, amount, arm_parts(skeleton))


def handedness(skeleton: Skeleton, directions: np.ndarray, side: str) -> np.ndarray:
    """Put the arm that is not on the given side into the rest pose; "both" is the unchanged motion.

    The arm that gestures, the trunk and the head do not change. For a motion that gestures with the other arm apply
    `mirror_directions` first.
    """
    if side == "both":
        return directions
    (other,) = set(SIDES) - {side}
    bones = bones_of(arm_parts(skeleton, other))
    result = np.array(directions, np.float32)
    result[:, bones] = rest_pose(skeleton)[bones]
    return result


def pin(skeleton: Skeleton, directions: np.ndarray, fps: float, pins: Sequence[Pin]) -> np.ndarray:
    """Make a motion hold poses of the whole body, or pass through them.

    More than half a second away from a pin the motion does not change. Pins do not overlap.
    """
    for one in pins:
        weight = motion_weight(one, [other for other in pins if other is not one], len(directions), fps)
        pose = rest_pose(skeleton) if one.pose is None else one.pose
        directions = scale_about(pose, directions, weight, parts(skeleton))
    return directions


def mute(skeleton: Skeleton, directions: np.ndarray, fps: float, mutes: Sequence[Span]) -> np.ndarray:
    """Remove gestures from spans of time that do not overlap: both arms rest, while trunk and head do not change.

    More than half a second away from a span the arms do not change either.
    """
    for one in mutes:
        weight = motion_weight(one, [other for other in mutes if other is not one], len(directions), fps)
        directions = scale_about(rest_pose(skeleton), directions, weight, arm_parts(skeleton))
    return directions


def motion_weight(span: Pin | Span, others: Sequence[Pin | Span], frames: int, fps: float) -> np.ndarray:
    """Compute the weight (T,) of the motion around a span: 0 within it, 1 at least `EASE` seconds away from it.

    Start and end are rounded to the nearest frames. The weight follows a minimum-jerk curve in the transitions. A
    transition is not longer than the gap to the next of the other spans.
    """
    first, last = (round(moment * fps) for moment in (span.start, span.end))
    gaps_before = [first - round(other.end * fps) for other in others if other.end <= span.start]
    gaps_after = [round(other.start * fps) - last for other in others if other.start >= span.end]
    eases = [max(1.0, min([EASE * fps, *gaps])) for gaps in (gaps_before, gaps_after)]
    frame = np.arange(frames)
    away = np.maximum(np.maximum((first - frame) / eases[0], (frame - last) / eases[1]), 0)
    return minimum_jerk(np.minimum(away, 1))


class Ramp:
    """Values (n,), `values`, that move to new ones within half a second, along a minimum-jerk curve."""

    def __init__(self, values: np.ndarray, fps: float):
        self._target = self._start = self.values = np.asarray(values, np.float64)
        self._frames = math.ceil(EASE * fps)
        self._frame = 0

    def step(self, target: np.ndarray, frames: int = 1) -> np.ndarray:
        """Return the values (n,) some frames later; the curve to a new target begins at the current values."""
        if not np.array_equal(target, self._target):
            self._target, self._start, self._frame = np.asarray(target, np.float64), self.values, 0
        self._frame = min(self._frame + frames, self._frames)
        weight = minimum_jerk(np.asarray(self._frame / self._frames))
        self.values = self._start + weight * (self._target - self._start)
        return self.values


def check_running(controls: Controls, skeleton: Skeleton) -> None:
    """Raise a UserError if a control of an ongoing motion is not valid, or needs later frames."""
    check(controls, skeleton)
    if controls.pins or controls.mutes:
        name = "pins" if controls.pins else "mutes"
        raise UserError(
            f"{name} are at times of a whole motion, which a stream does not have; leave them out, and set `muted` of "
            "the stream for a time without gestures"
        )


class RunningControls:
    """The controls energy, extent, handedness and mirror, and a mute, of an ongoing motion.

    Energy scales the movement about the mean of the poses so far, an exponential mean with a time constant of two
    seconds; in `energy` that mean is centred. The other controls have the same effect on a frame as in `apply`. Changes
    are eased over half a second.
    """

    def __init__(self, skeleton: Skeleton, fps: float, controls: Controls = NEUTRAL):
        self._skeleton = skeleton
        self._ramp = Ramp(_amounts(controls, is_muted=False), fps)
        self._least_weight = 1 / (_RUNNING_SECONDS * fps)
        self._sum = np.zeros((skeleton.num_bones, 3))
        self._num_frames = 0

    def apply(self, directions: np.ndarray, controls: Controls, *, is_muted: bool = False) -> np.ndarray:
        """Apply controls that pass `check_running` to the next frames (n, bones, 3): mirror, then scale, then rest.

        Where all controls are neutral the values stay; with `is_muted` both arms rest.
        """
        target = _amounts(controls, is_muted)
        frames = [self._frame(np.asarray(frame, np.float32)[None], self._ramp.step(target)) for frame in directions]
        return np.concatenate([np.zeros((0, *directions.shape[1:]), np.float32), *frames])

    def copy(self) -> "RunningControls":
        """Return a copy that continues from the same frame."""
        other = copy.copy(self)
        other._ramp, other._sum = copy.copy(self._ramp), self._sum.copy()
        return other

    @property
    def arms(self) -> np.ndarray:
        """Weights (2,) of the motion of the left and of the right arm in the last frame, 0 for one that rests."""
        return self._ramp.values[-2:]

    def _frame(self, frame: np.ndarray, amounts: np.ndarray) -> np.ndarray:
        scale, reach, mirrored, *arms = amounts.tolist()
        posture = self._posture(frame[0])
        if scale != 1:
            frame = scale_about_posture(self._skeleton, posture, frame, scale, parts(self._skeleton))
        if mirrored:  # during the transition, each part moves from one side to the other
            other = mirror_directions(self._skeleton, frame)
            frame = scale_about(other[0], frame, 1 - mirrored, parts(self._skeleton)) if mirrored < 1 else other
        frame = extent(self._skeleton, frame, reach)
        for side, weight in zip(SIDES, arms, strict=True):
            if weight < 1:
                frame = scale_about(rest_pose(self._skeleton), frame, weight, arm_parts(self._skeleton, side))
        return frame

    def _posture(self, pose: np.ndarray) -> np.ndarray:
        self._num_frames += 1
        self._sum += max(1 / self._num_frames, self._least_weight) * (pose - self._sum)
        return to_unit(self._sum, pose)


def _amounts(controls: Controls, is_muted: bool) -> np.ndarray:
    """Return energy, extent, the weight of the mirror image, and the weight of the motion in each arm."""
    arms = [0.0 if is_muted or controls.handedness not in (side, "both") else 1.0 for side in SIDES]
    return np.array([controls.energy, controls.extent, float(controls.mirror), *arms])
