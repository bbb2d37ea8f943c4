"""The end of a window that has not been heard yet, as training and a stream hide it.

While someone speaks, a window reaches into the future. Its unknown columns are hidden, so that a model knows where its
knowledge ends.
"""

import numpy as np

from ha2g_jax.features.audio import HOP_LENGTH, SAMPLE_RATE, window_column

# The value of all bands of a hidden column. 0 dB is the maximum of a clip, so that no sound has it in every band, and
# silence is at the other end of the range: no further input is needed to tell them apart.
HIDDEN_DB = 0.0


def heard_columns(end_frame: int, fps: float) -> int:
    """Return how many columns of a clip's spectrogram are known when its first frames have been heard.

    Column c is centred on sample 512 c and is computed from 1024 samples, so that it needs the first 512 (c + 1)
    samples of the clip; floor(end_frame / fps x 16000) of them have been heard.

    Args:
        end_frame: number of frames whose time has passed: the speech before the moment end_frame / fps is known.
        fps: frames per second.
    """
    return int(end_frame * SAMPLE_RATE // (fps * HOP_LENGTH))


def hide_unheard(mel: np.ndarray, start_frame: int, heard: int, fps: float) -> np.ndarray:
    """Hide the columns of a window that need speech from after its first frames.

    Args:
        mel: (128, columns) dB of a window.
        start_frame: first frame of the window in its clip, from 0.
        heard: number of frames of the window whose time has passed.
        fps: frames per second.

    Returns:
        (128, columns) dB, a copy in which the hidden columns are `HIDDEN_DB`.
    """
    known = heard_columns(start_frame + heard, fps) - window_column(start_frame, fps)
    hidden = np.array(mel)
    hidden[:, max(known, 0) :] = HIDDEN_DB
    return hidden
