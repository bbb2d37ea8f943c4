"""Joining of overlapping windows into one motion."""

import numpy as np

from ha2g_jax.motion.resample import exp_map, log_map, slerp
from ha2g_jax.motion.rotations import between, from_vector, rotate, to_vector
from ha2g_jax.motion.smoothing import minimum_jerk

DEFAULT_LOOK_AHEAD = 8
"""Default number of frames of speech that a stream hears beyond each frame; with fewer there are few beats."""

DEFAULT_HOP = 2
"""Default number of frames that a stream generates in one run: half the computation of 1, and better motion."""

_EASE_FRAMES = 10
_MOST_FADE = 6  # frames; chosen, like the share of the look-ahead, on the validation split of Talk
_TOLERANCE = 2.0  # times the usual deviation from the course; a larger one counts as a step


def window_stride(window: int, overlap: int) -> int:
    """Return the frames from one window of a recording to the next, two thirds of the N - M that a window adds.

    The last frames of a window are generated without the speech that follows; the next window generates them again.
    """
    return max(1, 2 * (window - overlap) // 3)


def num_windows(frames: int, window: int, stride: int) -> int:
    """Return the number of windows of N frames that cover T frames, K = max(1, ceil((T - N) / stride) + 1)."""
    return max(1, -((window - frames) // stride) + 1)


def join_windows(windows: np.ndarray, overlap: int, stride: int) -> np.ndarray:
    """Join windows (K, N, bones, 3) of unit vectors to one motion (N + (K - 1) stride, bones, 3).

    A window begins `stride` frames after the one before, and its first M frames are those that it was given. After them
    the prediction of the window before fades out: in M frames the weight of the later window is 1/(M+1), ..., M/(M+1),
    interpolated on the sphere. With a stride of N - M the fade is in the frames that were given.
    """
    num_frames = windows.shape[1]
    first = 0 if stride == num_frames - overlap else overlap
    join = RunningJoin(num_frames, overlap, stride, first)
    shown = [join.add(window) for window in windows]
    return np.concatenate([windows[0, :first], *(frames[:stride] for frames in shown), shown[-1][stride:]])


def ease_start(motion: np.ndarray, window: int, overlap: int) -> np.ndarray:
    """Remove the step after the M frames of a pose that a motion was given to start from.

    In its first M frames a window repeats the poses it was given. Its first new frame may deviate from their course,
    which is extrapolated by the mean of the steps before and after it. Other frames of a lively motion deviate too: if
    a bone deviates by more than twice the mean over the frames after it, it is rotated back to that distance, and the
    rotation fades out over the next 10 frames along a minimum-jerk curve (inertial blending, Bollo 2018).

    Args:
        motion: (T, bones, 3) unit vectors, of windows of N frames.
    """
    eased, longest = np.array(motion, np.float32), window - 2 * overlap
    if overlap >= len(motion) - 1:
        return eased
    earlier, before, first, after = eased[np.maximum(overlap + np.arange(-2, 2), 0)].astype(np.float64)
    onward = rotate(between(first, before), log_map(first, after))
    heading = exp_map(before, (onward - log_map(before, earlier)) / 2)
    rotation = to_vector(between(first, heading))
    distance = np.linalg.norm(rotation, axis=-1, keepdims=True)
    usual = _usual_distance(eased[overlap : overlap + longest])
    rotation *= np.maximum(0, 1 - _TOLERANCE * usual / np.maximum(distance, 1e-12))
    count = max(1, min(_EASE_FRAMES, longest))
    frames = eased[overlap : overlap + count]
    weight = 1 - minimum_jerk(np.arange(len(frames)) / count)
    frames[:] = rotate(from_vector(weight[:, None, None] * rotation), frames.astype(np.float64))
    return eased


def _usual_distance(motion: np.ndarray) -> np.ndarray:
    """Return half the mean third difference of each bone of a motion (T, bones, 3), (bones, 1) radians, or 0."""
    if len(motion) < 4:
        return np.zeros((motion.shape[1], 1))
    return np.linalg.norm(np.diff(motion.astype(np.float64), 3, axis=0), axis=-1, keepdims=True).mean(axis=0) / 2


class RunningJoin:
    """Windows that come one after the other, each `hop` frames later, joined as they come.

    A window shows the frames from number `first` on; those before it have been shown. The prediction of the window
    before for the first shown frames fades out in hop + 1 frames, at most M, so that the motion does not jump. With
    short hops and a look-ahead it fades out in up to 6 frames: several windows have then heard the speech of a frame,
    and their mean trembles less.

    Args:
        window, overlap: frames N of a window and M of the seed pose.
        hop: frames from one window to the next, 1 to N - 2 M.
        first: number of the first frame that is shown, M to N - hop.
        look_ahead: frames of speech that are heard beyond the last of the next `hop` frames.
    """

    def __init__(self, window: int, overlap: int, hop: int, first: int, look_ahead: int = 0):
        self._hop, self.first = hop, first
        fade = min(hop + 1, overlap)
        if fade < overlap:
            fade = max(fade, min(3 * look_ahead // 4, _MOST_FADE))
        self._fade = min(fade, window - first - hop)
        self._shown: np.ndarray | None = None

    def restart(self) -> None:
        """Let the next window be joined to nothing, like the first one."""
        self._shown = None

    def add(self, window: np.ndarray) -> np.ndarray:
        """Return the frames (N - first, bones, 3) from this window's first on, of which the first `hop` are final."""
        shown = np.array(window[self.first :], np.float32)
        if self._shown is not None:
            expected = self._shown[self._hop : self._hop + self._fade]
            weight = (np.arange(1, self._fade + 1, dtype=np.float32) / (self._fade + 1))[:, None, None]
            shown[: self._fade] = slerp(expected, shown[: self._fade], weight)
        self._shown = shown
        return shown
