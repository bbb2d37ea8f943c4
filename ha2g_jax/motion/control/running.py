"""Controls of a motion that goes on: each frame is changed when it comes, without those after it."""

import math

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.motion.control import effects
from ha2g_jax.motion.control.controls import NEUTRAL, Controls, check
from ha2g_jax.motion.control.effects import EASE
from ha2g_jax.motion.control.parts import SIDES, arm_parts, parts, rest_pose
from ha2g_jax.motion.control.scaling import scale_about, scale_about_posture
from ha2g_jax.motion.smoothing import minimum_jerk
from ha2g_jax.skeleton import Skeleton, mirror_directions

_POSTURE_SECONDS = effects.POSTURE_SECONDS / 2  # time constant of the mean of the poses so far


class Ramp:
    """Values that go to new ones within half a second, along a minimum-jerk curve.

    Args:
        values: (n,) values at the start.
        fps: frames per second.
    """

    def __init__(self, values: np.ndarray, fps: float):
        self._target = self._start = self._values = np.asarray(values, np.float64)
        self._frames = math.ceil(EASE * fps)
        self._frame = 0

    def step(self, target: np.ndarray, frames: int = 1) -> np.ndarray:
        """Return the values (n,) some frames later.

        Args:
            target: (n,) values to go to; where they are new, the way begins at the present values.
            frames: number of frames.
        """
        if not np.array_equal(target, self._target):
            self._target, self._start, self._frame = np.asarray(target, np.float64), self._values, 0
        self._frame = min(self._frame + frames, self._frames)
        weight = minimum_jerk(np.asarray(self._frame / self._frames))
        self._values = self._start + weight * (self._target - self._start)
        return self._values


def check_running(controls: Controls, skeleton: Skeleton) -> None:
    """Check controls of a motion that goes on.

    Args:
        controls: controls to check.
        skeleton: skeleton of the motion.

    Raises:
        UserError: a control is not valid, or needs the frames after it.
    """
    check(controls, skeleton)
    if controls.pins or controls.mutes:
        name = "pins" if controls.pins else "mutes"
        raise UserError(
            f"{name} are at times of a whole motion, which a stream does not have; leave them out, and set `muted` of "
            "the stream for a time without gestures"
        )


class RunningControls:
    """The controls energy, extent, handedness and mirror, and a mute, of a motion that goes on.

    Energy scales the movement about the mean of the poses so far, an exponential mean with a time constant of two
    seconds; in `effects.energy` that mean is centred. The other controls do to a frame what they do in
    `controls.apply`. Changes are eased over half a second.

    Args:
        skeleton: skeleton of the motion.
        fps: frames per second.
        controls: controls of the first frame.
    """

    def __init__(self, skeleton: Skeleton, fps: float, controls: Controls = NEUTRAL):
        self._skeleton = skeleton
        self._ramp = Ramp(_amounts(controls, is_muted=False), fps)
        self._least_weight = 1 / (_POSTURE_SECONDS * fps)
        self._sum = np.zeros((skeleton.num_bones, 3))
        self._num_frames = 0

    def apply(self, directions: np.ndarray, controls: Controls, *, is_muted: bool = False) -> np.ndarray:
        """Apply controls to the next frames: mirror, then scale, then rest.

        Args:
            directions: (n, bones, 3) unit vectors, the frames after those of the last call.
            controls: controls to apply, see `check_running`.
            is_muted: whether both arms rest.

        Returns:
            (n, bones, 3) float32 unit vectors; the same values where all controls are neutral.
        """
        target = _amounts(controls, is_muted)
        frames = [self._frame(np.asarray(frame, np.float32)[None], self._ramp.step(target)) for frame in directions]
        return np.concatenate([np.zeros((0, *directions.shape[1:]), np.float32), *frames])

    def _frame(self, frame: np.ndarray, amounts: np.ndarray) -> np.ndarray:
        """Return one frame (1, bones, 3) after the controls."""
        energy, extent, mirrored, *arms = amounts.tolist()
        posture = self._posture(frame[0])
        if energy != 1:
            frame = scale_about_posture(self._skeleton, posture, frame, energy, parts(self._skeleton))
        if mirrored:  # between the two, each part is on the way from one side to the other
            other = mirror_directions(self._skeleton, frame)
            frame = scale_about(other[0], frame, 1 - mirrored, parts(self._skeleton)) if mirrored < 1 else other
        frame = effects.extent(self._skeleton, frame, extent)
        for side, weight in zip(SIDES, arms, strict=True):
            if weight < 1:
                frame = scale_about(rest_pose(self._skeleton), frame, weight, arm_parts(self._skeleton, side))
        return frame

    def _posture(self, pose: np.ndarray) -> np.ndarray:
        """Add a pose (bones, 3) to the mean, and return the mean."""
        self._num_frames += 1
        self._sum += max(1 / self._num_frames, self._least_weight) * (pose - self._sum)
        lengths = np.linalg.norm(self._sum, axis=-1, keepdims=True)
        return np.where(lengths > 1e-6, self._sum / np.maximum(lengths, 1e-6), pose)


def _amounts(controls: Controls, is_muted: bool) -> np.ndarray:
    """Return energy, extent, the share of the mirror image, and the weight of the motion in each arm."""
    arms = [0.0 if is_muted or controls.handedness not in (side, "both") else 1.0 for side in SIDES]
    return np.array([controls.energy, controls.extent, float(controls.mirror), *arms])
