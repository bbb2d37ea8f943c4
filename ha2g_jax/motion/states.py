"""What a body does while it does not speak: it idles, listens or thinks.

A state is a row of amounts, `POSTURES`. At any time they can move to new values, along a curve of continuous velocity
and acceleration within `EASE` seconds. All are 0 where the motion is that of speech, so that this does not change.
"""

import copy
import functools
import math
from typing import NamedTuple

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.features import noise
from ha2g_jax.motion.control.parts import HEAD, SIDES, TRUNK, arm_parts, bones_of, bones_of_kind, rest_pose
from ha2g_jax.motion.idle import shifts
from ha2g_jax.motion.resample import slerp
from ha2g_jax.motion.rotations import between, from_vector, rotate, unit
from ha2g_jax.motion.smoothing import minimum_jerk
from ha2g_jax.skeleton import Skeleton

STATES = ("auto", "idle", "listen", "think")
EASE = 0.4  # seconds of a transition
ATTENTION = 1.5  # seconds for which listening goes on after the other speaker's last voice
NOD_DELAY = 0.7  # seconds from the end of a phrase to the lowest point of the nod
_NOD_DEGREES, _NOD_SECONDS = 13.0, 0.27  # depth of a nod, and seconds to go down and to go up

# Amounts of idle shifts, of a lean ahead, of turning the head to the other and of nods; of the degrees by which the
# head turns to the left and down; and of raising each arm.
POSTURES = {
    "speak": np.zeros(8),
    "idle": np.array([1.0, 0, 0, 0, 0, 0, 0, 0]),
    "listen": np.array([0.3, 1, 1, 1, 0, 0, 0, 0]),
    "think": np.array([0.3, 0, 0, 0, 1, 1, 1, 1]),
}
_FIRST_CHANNEL = np.uint32(2048)  # first channel of the noise for the state "think"
_UP = np.array([0.0, -1.0, 0.0])
_LEAN_DEGREES = 5.0
_GAZE_DEGREES = (22.0, 38.0), (-12.0, 8.0)  # ranges of the gaze while thinking: to a side, and down
# Directions of the upper arm and of the forearm of a hand below the chin, to the side of the arm, down and ahead: near
# enough that a hand that hangs comes there with at most 3 m/s.
_RAISED = (0.2, 0.96, 0.15), (-0.7, -0.4, 0.6)


class RunningStates:
    """The movement that states add to the frames of an ongoing motion.

    Attributes:
        state: one of `STATES`; "auto" listens while the other speaks and idles otherwise. "think" becomes "auto" with
            the next speech.
    """

    def __init__(self, skeleton: Skeleton, fps: float, seed: int):
        self._skeleton, self._fps, self._seed = skeleton, fps, seed
        self._ramp: Ease | None = None  # begins at the first frame
        self._weight = 0.0  # weight of the speech in the previous frame
        self._thought = POSTURES["think"]
        self._num_thoughts = 0
        self._state = "auto"

    @property
    def state(self) -> str:
        return self._state

    @state.setter
    def state(self, state: str) -> None:
        if state not in STATES:
            raise UserError(f"the state is {state!r}; expected one of: {', '.join(STATES)}")
        if state == "think" != self._state:
            self._thought = self._think()
        self._state = state

    def apply(
        self, frame: np.ndarray, number: int, weight: float, nod: float, *, is_addressed: bool, arms: np.ndarray
    ) -> np.ndarray:
        """Add the movement to the next frame, (bones, 3) unit vectors.

        Args:
            number: number of the frame.
            weight: weight of the motion of speech in the frame; where it is 1 the frame stays as it is.
            nod: depth of a nod in the frame, 0 to 1, see `nod_depths`.
            is_addressed: whether the other speaker speaks.
            arms: (2,) weights of the movement of the left and the right arm, 0 for one that rests.
        """
        begins = weight > self._weight
        is_speech = begins or weight == 1
        if begins and self._state == "think":
            self._state = "auto"
        state = ("listen" if is_addressed else "idle") if self._state == "auto" else self._state
        target = POSTURES["speak"] if is_speech else self._thought if state == "think" else POSTURES[state]
        if self._ramp is None:
            self._ramp = Ease(target, math.ceil(EASE * self._fps))
        self._weight = weight
        amounts = self._ramp.step(target)
        return self._moved(frame, number, amounts, nod, arms) if amounts.any() else frame

    def copy(self) -> "RunningStates":
        """Return a copy that continues from the same frame."""
        other = copy.copy(self)
        other._ramp = copy.copy(self._ramp)
        return other

    def _moved(self, frame: np.ndarray, number: int, amounts: np.ndarray, nod: float, arms: np.ndarray) -> np.ndarray:
        shift, lean, ahead, nods, aside, down, *raised = amounts.tolist()
        body = _body(self._skeleton)
        turns = shift * shifts(self._skeleton, self._seed, np.array([number]), self._fps)[0]
        moved = frame.astype(np.float64)
        for arm, share, weight in zip(body.arms, raised, arms.tolist(), strict=True):
            turns[arm.bones] *= weight
            if share * weight:
                bent = slerp(moved[arm.bones[:2]], arm.raised, np.array(share * weight))
                moved[arm.bones[2:]] = rotate(between(moved[arm.bones[1]], bent[1]), moved[arm.bones[2:]])
                moved[arm.bones[:2]] = bent
        turns[body.trunk] += np.deg2rad(lean * _LEAN_DEGREES) * body.left
        turns[body.head] += np.deg2rad(down + nods * nod * _NOD_DEGREES) * body.left
        turns[body.head] += (np.deg2rad(aside) - ahead * _yaw(self._skeleton, frame)) * _UP
        return rotate(from_vector(turns), moved).astype(np.float32)

    def _think(self) -> np.ndarray:
        """Return the amounts of the next thought, whose gaze and arm are drawn."""
        seed, number = (np.array([value], np.uint32) for value in (self._seed, self._num_thoughts))
        draws = noise.normal(seed, number, _FIRST_CHANNEL + np.arange(4, dtype=np.uint32)) * 16 % 1
        self._num_thoughts += 1
        side = 1 if draws[0] < 0.5 else -1
        aside, down = (low + draw * (high - low) for (low, high), draw in zip(_GAZE_DEGREES, draws[1:], strict=False))
        arm = [1.0, 0.0] if draws[3] < 0.5 else [0.0, 1.0]
        return POSTURES["think"] * np.array([1, 1, 1, 1, side * aside, down, *arm])


def nod_depths(ends: list[float], frames: np.ndarray, fps: float) -> np.ndarray:
    """Return the depths (T,) of the nods at frames (T,), 0 to 1: a nod is due at the end of each phrase.

    It is lowest `NOD_DELAY` seconds after the end of a phrase of the other's voice, in seconds, at the nearest frame.
    """
    depths = np.zeros(len(frames))
    for end in ends:
        away = np.abs(frames - round((end + NOD_DELAY) * fps)) / (_NOD_SECONDS * fps)
        depths = np.maximum(depths, minimum_jerk(1 - np.minimum(away, 1)))
    return depths


class Ease:
    """Values that reach new ones a number of frames later, along a curve of the fifth degree.

    The curve to a new target continues with the current velocity and acceleration, and ends at rest.
    """

    def __init__(self, values: np.ndarray, frames: int):
        self._target, self._frames, self._frame = np.asarray(values, np.float64), frames, frames
        self._curve = np.zeros((6, len(values)))  # coefficients of the remaining curve, over a time from 0 to 1

    def step(self, target: np.ndarray) -> np.ndarray:
        """Return the values (n,) of the next frame, on the way to a target (n,)."""
        if not np.array_equal(target, self._target):
            time = self._frame / self._frames
            values = self._target + _powers(time) @ self._curve
            velocity, acceleration = _powers(time, 1) @ self._curve, _powers(time, 2) @ self._curve
            start = np.stack([values - target, velocity, acceleration / 2])
            self._curve = np.concatenate([start, _ENDING @ start])
            self._target, self._frame = np.array(target, np.float64), 0
        self._frame = min(self._frame + 1, self._frames)
        if self._frame == self._frames:
            self._curve = np.zeros_like(self._curve)
        return self._target + _powers(self._frame / self._frames) @ self._curve


def _powers(time: float, derivative: int = 0) -> np.ndarray:
    """Return the powers 0 to 5 of a time, or their derivatives."""
    factors = [math.perm(power, derivative) for power in range(6)]
    return np.array([factor * time ** max(power - derivative, 0) for power, factor in enumerate(factors)])


# Coefficients 3 to 5 of the curve that is 0 and at rest at the time 1, from those before them.
_ENDING = np.array([[-10.0, -6.0, -3.0], [15.0, 8.0, 3.0], [-6.0, -3.0, -1.0]])


class _Arm(NamedTuple):
    """Bones of an arm, upper arm and forearm first, and these two (2, 3) with the hand below the chin."""

    bones: list[int]
    raised: np.ndarray


class _Body(NamedTuple):
    """Bones of a skeleton, and the unit vector (3,) to the figure's left."""

    left: np.ndarray
    trunk: list[int]
    head: list[int]
    arms: tuple[_Arm, ...]


@functools.cache
def _body(skeleton: Skeleton) -> _Body:
    left = np.array([skeleton.left, 0.0, 0.0])
    trunk, head = (bones_of_kind(skeleton, kind) for kind in (TRUNK, HEAD))
    arms = []
    for side, sign in zip(SIDES, (1, -1), strict=True):
        axes = np.stack([sign * left, -_UP, np.cross(left, _UP)])
        arms.append(_Arm(bones_of(arm_parts(skeleton, side)), unit(np.array(_RAISED)) @ axes))
    return _Body(left, trunk, head, tuple(arms))


def _yaw(skeleton: Skeleton, pose: np.ndarray) -> float:
    """Return the angle in radians by which the head of a pose (bones, 3) is turned to the left."""
    body = _body(skeleton)
    plane = np.stack([np.cross(body.left, _UP), body.left], axis=-1)  # ahead and left
    rest, turned = _rest_head(skeleton) @ plane, pose[body.head] @ plane
    return float(np.arctan2(np.sum(rest[:, 0] * turned[:, 1] - rest[:, 1] * turned[:, 0]), np.sum(rest * turned)))


@functools.cache
def _rest_head(skeleton: Skeleton) -> np.ndarray:
    return rest_pose(skeleton)[_body(skeleton).head]
