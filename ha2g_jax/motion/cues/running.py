"""Blending of gestures into an ongoing motion, frame by frame; files and streams use the same code."""

import copy
import dataclasses
import math
from collections.abc import Iterable

import numpy as np

from ha2g_jax.motion.control.parts import apply_rotations, bones_of, power, rotations_from
from ha2g_jax.motion.cues.catalogue import Keyframes, limbs
from ha2g_jax.motion.resample import angles, slerp
from ha2g_jax.motion.rotations import from_vector, rotate
from ha2g_jax.motion.smoothing import minimum_jerk
from ha2g_jax.skeleton import Skeleton

MAX_SPEED = 9.0
"""Radians per second: the greatest angular speed of a bone that a cue moves."""

MOST = 64
"""Number of gestures of one motion that may run at a time, and of a stream that may wait."""

_PEAK_SPEED = 1.875  # of a minimum-jerk movement, relative to its mean speed


def apply(
    skeleton: Skeleton,
    directions: np.ndarray,
    fps: float,
    gestures: Iterable[tuple[Keyframes, float | None]],
    before: np.ndarray | None = None,
) -> np.ndarray:
    """Blend gestures with their times in seconds into a whole motion (T, bones, 3), see `RunningCues`.

    A gesture that begins before the motion has already begun in its first frame, unless the motion continues from a
    pose `before`; one that lasts longer than the motion ends with it.
    """
    running = RunningCues(skeleton, fps, before)
    for keys, time in gestures:
        running.add(keys, time)
    return running.apply(directions)


@dataclasses.dataclass
class _Running:
    """A gesture that waits or runs.

    Attributes:
        peak: number of the frame of its peak; None for as soon as possible.
        limbs: limbs that no later gesture has taken over.
        ramp: seconds from its beginning to its first keyframe; None while it waits.
        rank: frame by which it is later than other gestures: its peak; of a clip of the whole body, its first pose.
            When a gesture as soon as possible begins, those that run get no later rank than it has.
        is_planned: whether the peak is final.
        rotations: last rotations from its pose to the motion, by limb, from which the next ones continue.
    """

    keys: Keyframes
    peak: int | None
    limbs: list[str]
    ramp: float | None = None
    rank: float = 0.0
    is_planned: bool = False
    rotations: dict[str, np.ndarray] = dataclasses.field(default_factory=dict)


class RunningCues:
    """Gestures that are blended into a motion, each with its peak in a given frame.

    A gesture eases in and out by minimum jerk, and begins early enough to reach its first pose; if it is too late for
    that, its peak is as early as possible. Limbs that it does not use do not change at all. If two gestures use a limb,
    the later one takes over from the current pose, and keeps the limb from its peak on. No bone that a gesture moves
    turns faster than `MAX_SPEED`.

    Attributes:
        frame: number of the next frame of the motion.
    """

    def __init__(self, skeleton: Skeleton, fps: float, before: np.ndarray | None = None):
        """Begin at frame 0, after the pose `before` (bones, 3); without one, the motion may begin within a gesture."""
        self._fps, self._last, self.frame = fps, before, 0
        self._limbs = limbs(skeleton)
        self._bones = {limb: bones_of(of_limb) for limb, of_limb in self._limbs.items()}
        self._cues: list[_Running] = []  # those that run, by rank, and then those that wait

    def add(self, keys: Keyframes, time: float | None = None) -> None:
        """Add a gesture whose peak is at a time of the motion in seconds; None for as soon as possible."""
        peak = None if time is None else round(time * self._fps)
        self._cues.append(_Running(keys, peak, [*keys.poses, *keys.turns]))

    def copy(self) -> "RunningCues":
        """Return a copy that continues from the same frame."""
        other = copy.copy(self)
        other._cues = [dataclasses.replace(cue, rotations=dict(cue.rotations)) for cue in self._cues]
        return other

    @property
    def num_waiting(self) -> int:
        """Number of gestures that have not begun."""
        return sum(cue.ramp is None for cue in self._cues)

    def drop_waiting(self) -> None:
        """Drop the gestures that have not begun."""
        self._cues = [cue for cue in self._cues if cue.ramp is not None]

    def apply(self, directions: np.ndarray) -> np.ndarray:
        """Return the next frames (n, bones, 3) with gestures, float32 unit vectors; without any, the same array."""
        if not self._cues:
            self.frame += len(directions)
            self._last = directions[-1] if len(directions) else self._last
            return directions
        return np.stack([self._next(frame) for frame in directions]) if len(directions) else directions

    def _next(self, motion: np.ndarray) -> np.ndarray:
        self._begin(motion)
        running = sorted((cue for cue in self._cues if cue.ramp is not None), key=lambda cue: cue.rank)
        frame = np.array(motion, np.float32)
        for index, cue in enumerate(running):
            if self._time(cue) >= 0:
                for earlier in running[:index]:
                    earlier.limbs = [limb for limb in earlier.limbs if limb not in cue.limbs]
        for index, cue in enumerate(running):
            self._blend(frame, cue, running[index + 1 :])
        late = self._slow_down(frame, {limb for cue in running for limb in cue.limbs})
        self._cues = [
            cue
            for cue in self._cues
            if cue.ramp is None
            or (cue.limbs and (self._time(cue) < cue.keys.weight_times[-1] or late.intersection(cue.limbs)))
        ]
        self._last = frame
        self.frame += 1
        return frame

    def _begin(self, motion: np.ndarray) -> None:
        """Begin the gestures whose time has come."""
        present = motion if self._last is None else self._last
        running = sorted((cue for cue in self._cues if cue.ramp is not None), key=lambda cue: cue.rank)
        waiting = [cue for cue in self._cues if cue.ramp is None]
        for cue in waiting:
            if len(running) == MOST:  # the others begin as soon as possible
                break
            start, first = cue.keys.weight_times[:2].tolist()
            ramp = max(first - start, self._way(cue, present) * _PEAK_SPEED / MAX_SPEED)
            soonest = self.frame - 1 + math.ceil((ramp - first) * self._fps)
            peak = soonest if cue.peak is None else cue.peak
            if self._last is not None and not cue.is_planned:
                peak = max(peak, soonest)
            if not cue.is_planned:
                is_clip = not cue.keys.turns and len(cue.keys.poses) == len(self._limbs)
                cue.rank = peak + (cue.keys.times[0] * self._fps if is_clip else 0)
            if cue.peak is None:
                for one in running:
                    one.rank = min(one.rank, cue.rank)
            cue.peak, cue.is_planned = peak, True
            if peak <= soonest:
                left = (peak - self.frame + 1) / self._fps + first
                cue.ramp = ramp if self._last is None else max(left, 1 / self._fps)
                running.append(cue)
        self._cues = [*running, *(cue for cue in waiting if cue.ramp is None)]

    def _way(self, cue: _Running, present: np.ndarray) -> float:
        """Return the largest angle that a bone turns from the current pose to the first one of a gesture."""
        ways = [angles(present[self._bones[limb]], poses[0]).max() for limb, poses in cue.keys.poses.items()]
        return float(max(ways, default=0.0))

    def _blend(self, frame: np.ndarray, cue: _Running, later: list[_Running]) -> None:
        """Blend a gesture into a frame (bones, 3), under later ones."""
        keys, weight = cue.keys, self._weight(cue)
        before, after, fraction = _place(keys.times, self._time(cue))
        for limb in cue.limbs if weight else ():
            bones = self._bones[limb]
            if limb in keys.poses:
                pose = slerp(keys.poses[limb][before], keys.poses[limb][after], np.asarray(fraction))
                frame[bones] = self._toward(frame, pose, weight, cue, limb)
            else:
                share = math.prod(1 - self._weight(one) for one in later if limb in one.keys.turns)
                first, second = keys.turns[limb][before], keys.turns[limb][after]
                turn = weight * share * (first + fraction * (second - first))
                frame[bones] = rotate(from_vector(turn), frame[bones])

    def _toward(self, frame: np.ndarray, pose: np.ndarray, weight: float, cue: _Running, limb: str) -> np.ndarray:
        """Return the bones of a limb, blended from a frame (bones, 3) to a pose of the limb."""
        chosen = self._limbs[limb]
        reference = frame.astype(np.float64)
        reference[self._bones[limb]] = pose
        rotations = rotations_from(reference, frame[None], chosen)
        if limb in cue.rotations:
            is_near = np.sum(rotations * cue.rotations[limb], axis=-1, keepdims=True) >= 0
            rotations = np.where(is_near, rotations, -rotations)
        cue.rotations[limb] = rotations
        return apply_rotations(reference, power(rotations, np.array(1 - weight)), chosen)[0]

    def _slow_down(self, frame: np.ndarray, moved: set[str]) -> set[str]:
        """Turn the bones of limbs no farther than `MAX_SPEED` allows, and return the limbs that are late."""
        late = set()
        last = frame if self._last is None else self._last
        for limb in moved:
            bones = np.array(self._bones[limb])
            turned = angles(last[bones], frame[bones])
            is_fast = turned[:, 0] > MAX_SPEED / self._fps
            if is_fast.any():
                bones, share = bones[is_fast], MAX_SPEED / self._fps / turned[is_fast]
                frame[bones] = slerp(last[bones], frame[bones], share)
                late.add(limb)
        return late

    def _time(self, cue: _Running) -> float:
        return (self.frame - (cue.peak or 0)) / self._fps

    def _weight(self, cue: _Running) -> float:
        times = cue.keys.weight_times.copy()
        times[0] = times[1] - (cue.ramp or 0)
        before, after, fraction = _place(times, self._time(cue))
        return float(cue.keys.weights[before] + fraction * (cue.keys.weights[after] - cue.keys.weights[before]))


def _place(times: np.ndarray, time: float) -> tuple[int, int, float]:
    """Return the keyframes before and after a time, and the fraction between them, by minimum jerk."""
    after = min(max(int(np.searchsorted(times, time, side="right")), 1), len(times) - 1)
    before = max(after - 1, 0)
    span = times[after] - times[before]
    share = min(max((time - times[before]) / span, 0.0), 1.0) if span else 0.0
    return before, after, float(minimum_jerk(np.asarray(share)))
