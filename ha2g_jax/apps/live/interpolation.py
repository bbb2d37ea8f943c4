"""Frames between the frames of a model, as they arrive."""

import math

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.skeleton import normalize

MAX_FPS = 120


class Interpolation:
    """Change of the frame rate of a motion that arrives frame by frame, linear between two frames of the model.

    Frame j of the result shows the time j / target. It is returned with the first frame of the model at or after this
    time, so that it comes `delay` seconds later than a frame of the model at most.
    """

    def __init__(self, fps: int, target: int) -> None:
        """Start without frames.

        Args:
            fps: frames per second of the model.
            target: frames per second of the result, `fps` to 120.

        Raises:
            UserError: the target is below `fps` or above 120.
        """
        if not fps <= target <= MAX_FPS:
            raise UserError(f"{target} frames per second; expected {fps}, the rate of the model, to {MAX_FPS}")
        self.target = target
        self._fps, self._taken, self._returned = fps, 0, 0
        self._last: np.ndarray | None = None

    @property
    def delay(self) -> float:
        """Seconds that a frame of the result waits at most for the frame of the model after it."""
        return 1 / self._fps - math.gcd(self._fps, self.target) / (self._fps * self.target)

    def add(self, frames: np.ndarray) -> np.ndarray:
        """Take the next frames of the model, and return those of the result that are complete.

        Args:
            frames: (n, bones, 3) unit vectors.

        Returns:
            (m, bones, 3) unit vectors.
        """
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
