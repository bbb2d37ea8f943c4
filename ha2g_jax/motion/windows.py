"""Windows that overlap, and the motion they join to."""

import numpy as np

from ha2g_jax.motion.resample import exp_map, log_map, slerp
from ha2g_jax.motion.rotations import between, from_vector, rotate, to_vector
from ha2g_jax.motion.smoothing import minimum_jerk

_EASE_FRAMES = 10


def num_windows(frames: int, window: int, overlap: int) -> int:
    """K = max(1, ceil((T - N) / (N - M)) + 1): windows of N frames, M of them shared, that cover T frames."""
    return max(1, -((window - frames) // (window - overlap)) + 1)


def join_windows(windows: np.ndarray, overlap: int) -> np.ndarray:
    """Windows (K, N, bones, 3) of unit vectors as one motion, (N + (K - 1)(N - M), bones, 3).

    Over the M frames that two windows share, the later one's share grows as 1/(M+1), ..., M/(M+1), along the sphere.
    """
    share = (np.arange(1, overlap + 1, dtype=np.float32) / (overlap + 1))[None, :, None, None]
    faded = slerp(windows[:-1, -overlap:], windows[1:, :overlap], share)
    body = np.concatenate([windows[:-1, overlap:-overlap], faded], axis=1)
    return np.concatenate([windows[0, :overlap], body.reshape(-1, *body.shape[2:]), windows[-1, overlap:]])


def ease_borders(motion: np.ndarray, window: int, overlap: int, *, from_start: bool = False) -> np.ndarray:
    """The motion of `join_windows` without the step where a window leaves the frames it shares with the one before.

    In those M frames a window repeats what it was given; in the first frame of its own it is where it thinks it should
    be. That frame is turned to where the motion was heading, by the mean of the steps before and after it, and the
    turn fades out over the next 10 frames along a minimum-jerk course (as in the inertial blending of games, Bollo
    2018). Nothing before the border changes, so it can be done as windows come.

    Args:
        motion: (T, bones, 3) unit vectors.
        window: N.
        overlap: M.
        from_start: whether the first M frames were given, too.

    Returns:
        (T, bones, 3) float32 unit vectors.
    """
    stride = window - overlap
    own = np.arange(overlap if from_start else stride + overlap, len(motion) - 1, stride)
    eased = np.array(motion, np.float32)
    earlier, before, first, after = (eased[np.maximum(own + step, 0)].astype(np.float64) for step in (-2, -1, 0, 1))
    onward = rotate(between(first, before), log_map(first, after))
    heading = exp_map(before, (onward - log_map(before, earlier)) / 2)
    turn = to_vector(between(first, heading))
    count = max(1, min(_EASE_FRAMES, stride - overlap))  # all before the next border
    for step, share in enumerate(1 - minimum_jerk(np.arange(count) / count)):
        frames = own + step
        exists = frames < len(eased)
        eased[frames[exists]] = rotate(from_vector(share * turn[exists]), eased[frames[exists]].astype(np.float64))
    return eased
