"""Frames of a live run: poses in the rigs of the sinks, and interpolation between the frames of the model."""

import dataclasses
import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.motion import rigs, solver
from ha2g_jax.motion.armature import Animation
from ha2g_jax.motion.rigs import Transfer
from ha2g_jax.skeleton import Skeleton, normalize

MAX_FPS = 120


class Frame(NamedTuple):
    """One pose on its way to the sinks.

    Attributes:
        number: number of the frame, from 0.
        seconds: moment of the sound that it belongs to, number / fps.
        heard: time of the clock at which that moment is heard.
        skeleton: skeleton of the model.
        directions: (bones, 3) unit vectors, the pose of the model, interpolated at a higher frame rate.
        animations: the pose as an animation of one frame, by the name of the rig.
    """

    number: int
    seconds: float
    heard: float
    skeleton: Skeleton
    directions: np.ndarray
    animations: dict[str, Animation]


class Rigs:
    """Conversion of direction vectors to the rigs of the sinks.

    Args:
        skeleton: skeleton of the direction vectors.
        fps: frames per second.
        names: names of the rigs, from `motion.rigs.RIGS`.

    Raises:
        UserError: there is no such rig.
    """

    def __init__(self, skeleton: Skeleton, fps: float, names: Iterable[str]) -> None:
        self._solver = solver.Solver(skeleton, fps)
        own = self._solver.armature
        loaded = [rigs.load_rig(name) for name in sorted(set(names))]
        self._transfers = {rig.name: Transfer.between(own, rig) if rig.name != own.name else None for rig in loaded}
        self._last: dict[str, np.ndarray] = {}
        # The solver imports large libraries at its first use; this is done here so that the first frame is not late.
        solver.Solver(skeleton, fps).animate(skeleton.mean_directions[None])

    def convert(self, directions: np.ndarray) -> list[dict[str, Animation]]:
        """Return the next frames (n, bones, 3), each as an animation of one frame for each rig, by its name.

        Eight frames at once take about as long as one.
        """
        if not self._transfers or not len(directions):
            return [{} for _ in directions]
        own, animations = self._solver.animate(directions), {}
        for name, transfer in self._transfers.items():
            animations[name] = own if transfer is None else transfer.apply(own, self._last.get(name))
            self._last[name] = animations[name].rotations[-1]
        return [{name: _frame(it, number) for name, it in animations.items()} for number in range(len(directions))]


def _frame(animation: Animation, number: int) -> Animation:
    one = slice(number, number + 1)
    return dataclasses.replace(animation, rotations=animation.rotations[one], translation=animation.translation[one])


class Interpolation:
    """Change of the frame rate of a motion that arrives frame by frame, linear between two frames of the model.

    Frame j of the result shows the time j / target. It is returned with the first frame of the model at or after this
    time, so that it comes at most `delay` seconds later than a frame of the model.

    Args:
        fps: frames per second of the model.
        target: frames per second of the result.

    Raises:
        UserError: the target is below `fps` or above 120.
    """

    def __init__(self, fps: int, target: int) -> None:
        if not fps <= target <= MAX_FPS:
            raise UserError(f"{target} frames per second; expected {fps}, the rate of the model, to {MAX_FPS}")
        self.target = target
        self._fps, self._taken, self._returned = fps, 0, 0
        self._last: np.ndarray | None = None

    @property
    def delay(self) -> float:
        """Longest time in seconds that a frame of the result waits for the next frame of the model."""
        return 1 / self._fps - math.gcd(self._fps, self.target) / (self._fps * self.target)

    def add(self, frames: np.ndarray) -> np.ndarray:
        """Take the next frames (n, bones, 3) of the model, and return those of the result that are complete."""
        if self._last is not None:
            frames = np.concatenate([self._last[None], frames])
        if not len(frames):
            return frames
        first = self._taken - (self._last is not None)  # number of frames[0]
        self._taken, self._last = first + len(frames), frames[-1]
        return self._until((self._taken - 1) * self.target // self._fps + 1, first, frames)

    def end(self) -> np.ndarray:
        """Return the frames after the last frame of the model, which hold its pose."""
        if self._last is None:
            return np.zeros((0, 0, 3), np.float32)
        return self._until(round(self._taken * self.target / self._fps), self._taken - 1, self._last[None])

    def _until(self, count: int, first: int, frames: np.ndarray) -> np.ndarray:
        """Return the frames of the result before number `count`, from frames of the model from number `first` on."""
        numbers = np.arange(self._returned, max(count, self._returned))
        self._returned += len(numbers)
        whole, part = np.divmod(numbers * self._fps, self.target)
        before = np.minimum(whole - first, len(frames) - 1)
        after = np.minimum(before + 1, len(frames) - 1)
        weight = (part / self.target).astype(np.float32)[:, None, None]
        between = normalize(frames[before] + weight * (frames[after] - frames[before]))
        return np.where(weight == 0, frames[before], between)
