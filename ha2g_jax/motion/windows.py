"""Windows that overlap, and the motion they join to."""

import numpy as np

from ha2g_jax.motion.resample import slerp


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
