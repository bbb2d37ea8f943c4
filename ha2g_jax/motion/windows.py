"""Joining of overlapping windows to one motion."""

import numpy as np

from ha2g_jax.motion.resample import exp_map, log_map, slerp
from ha2g_jax.motion.rotations import between, from_vector, rotate, to_vector
from ha2g_jax.motion.smoothing import minimum_jerk

DEFAULT_LOOK_AHEAD = 8
"""Frames of speech that a stream hears beyond each frame where nothing else is asked for; fewer give few beats."""

DEFAULT_HOP = 2
"""Frames of a stream that are generated in one run: half the computation of 1, and motion that fits no worse."""

_EASE_FRAMES = 10
_TOLERANCE = 2.0  # times the usual distance from the course, which is no step


def num_windows(frames: int, window: int, overlap: int) -> int:
    """Return the number of windows of N frames that cover T frames, K = max(1, ceil((T - N) / (N - M)) + 1)."""
    return max(1, -((window - frames) // (window - overlap)) + 1)


def join_windows(windows: np.ndarray, overlap: int) -> np.ndarray:
    """Join windows (K, N, bones, 3) of unit vectors to one motion (N + (K - 1)(N - M), bones, 3).

    In the M frames in common the later window's weight is 1/(M+1), ..., M/(M+1), interpolated on the sphere.
    """
    weight = (np.arange(1, overlap + 1, dtype=np.float32) / (overlap + 1))[None, :, None, None]
    faded = slerp(windows[:-1, -overlap:], windows[1:, :overlap], weight)
    body = np.concatenate([windows[:-1, overlap:-overlap], faded], axis=1)
    return np.concatenate([windows[0, :overlap], body.reshape(-1, *body.shape[2:]), windows[-1, overlap:]])


def ease_borders(motion: np.ndarray, window: int, overlap: int, *, from_start: bool = False) -> np.ndarray:
    """Remove the step in a motion of `join_windows` at the border after the M frames that two windows have in common.

    In its first M frames a window repeats the poses it was given; its first new frame may lie off the course of these,
    which the mean of the steps before and after it extrapolates. So do other frames of a lively motion: where a bone is
    farther off than twice the mean over the frames after the border, it is rotated back to that distance, and the
    rotation fades out over the next 10 frames along a minimum-jerk curve (inertial blending, Bollo 2018). Frames before
    the border do not change, so that a stream can be treated window by window.

    Args:
        motion: (T, bones, 3) unit vectors, of windows of N frames with an overlap of M.
        from_start: whether the first M frames of the motion were given, too.
    """
    stride = window - overlap
    own = np.arange(overlap if from_start else stride + overlap, len(motion) - 1, stride)
    return _ease(motion, own, stride - overlap)


def _ease(motion: np.ndarray, own: np.ndarray, longest: int) -> np.ndarray:
    """Ease the borders before the frames `own`, each within at most `longest` frames, see `ease_borders`."""
    eased = np.array(motion, np.float32)
    earlier, before, first, after = (eased[np.maximum(own + step, 0)].astype(np.float64) for step in (-2, -1, 0, 1))
    onward = rotate(between(first, before), log_map(first, after))
    heading = exp_map(before, (onward - log_map(before, earlier)) / 2)
    rotation = to_vector(between(first, heading))
    distance = np.linalg.norm(rotation, axis=-1, keepdims=True)
    rotation *= np.maximum(0, 1 - _TOLERANCE * _usual_distance(eased, own, longest) / np.maximum(distance, 1e-12))
    count = max(1, min(_EASE_FRAMES, longest))  # all before the next border
    for step, weight in enumerate(1 - minimum_jerk(np.arange(count) / count)):
        frames = own + step
        exists = frames < len(eased)
        eased[frames[exists]] = rotate(from_vector(weight * rotation[exists]), eased[frames[exists]].astype(np.float64))
    return eased


def _usual_distance(motion: np.ndarray, own: np.ndarray, longest: int) -> np.ndarray:
    """Return half the mean third difference of each bone after each border, (borders, bones, 1) radians, or 0."""
    if longest < 4:
        return np.zeros((len(own), *motion.shape[1:-1], 1))
    after = motion[np.minimum(own[:, None] + np.arange(longest), len(motion) - 1)].astype(np.float64)
    distances = np.linalg.norm(np.diff(after, 3, axis=1), axis=-1, keepdims=True) / 2
    return distances.mean(axis=1)


class RunningJoin:
    """Windows that come one after the other, each `hop` frames later, joined as they come.

    A window shows the frames from its `first` one on; those before it have been shown. What the window before expected
    of the first frames that are shown fades out, so that the motion does not jump. With a hop of N - M, where two
    windows have no frames but the seed pose in common, the result is that of `join_windows` and `ease_borders`.

    Args:
        window, overlap: frames N of a window and M of the seed pose.
        hop: frames from one window to the next, 1 to N - 2 M, or N - M.
        first: number of the first frame that is shown, M to N - hop; not used with a hop of N - M.
    """

    def __init__(self, window: int, overlap: int, hop: int, first: int | None = None):
        self._overlap, self._hop = overlap, hop
        self._longest = window - 2 * overlap
        self._is_whole = hop == window - overlap
        self.first = 0 if self._is_whole else overlap if first is None else first
        self._fade = overlap if self._is_whole else min(hop + 1, overlap, window - self.first - hop)
        self._shown: np.ndarray | None = None

    def restart(self) -> None:
        """Let the next window be joined to nothing, like the first one."""
        self._shown = None

    def add(self, window: np.ndarray) -> np.ndarray:
        """Return the frames (N - first, bones, 3) from this window's first on, of which the first `hop` are final."""
        shown = np.array(window[self.first :], np.float32)
        if self._shown is not None:
            weight = (np.arange(1, self._fade + 1, dtype=np.float32) / (self._fade + 1))[:, None, None]
            expected = self._shown[self._hop : self._hop + self._fade]
            shown[: self._fade] = slerp(expected, shown[: self._fade], weight)
            if self._is_whole:
                before = self._shown[max(self._hop - 2, 0) : self._hop]
                border = np.array([len(before) + self._overlap])
                shown = _ease(np.concatenate([before, shown]), border, self._longest)[len(before) :]
        self._shown = shown
        return shown
