"""Input of a speech recognition encoder: Whisper's log-mel spectrogram (Radford et al. 2022, section 2.2).

16 kHz, FFT 400, hop 160, periodic Hann window, centred frames with reflected borders, mel bands of Slaney's scale and
area normalisation over 0-8 kHz, log10 of the power, floor 80 dB below the loudest value, (x + 4) / 4. As with D11, the
loudest value is that of the clip that a window is cut from: the spectrogram is computed once per clip and sliced at the
nearest column, so that all windows of a clip have the same floor. Whisper itself takes the loudest value of its 30 s.
"""

import math

import numpy as np

from ha2g_jax.features.spectrum import mel_spectrum, power_spectrum

NUM_ASR_MELS = 80  # mel bands of Whisper's models, except large-v3 and its derivatives, which have 128
ASR_COLUMNS_PER_SECOND = 100

_SAMPLE_RATE = 16000
_FFT_SIZE = 400
_HOP_LENGTH = _SAMPLE_RATE // ASR_COLUMNS_PER_SECOND
_LEAST_POWER = 1e-10
_DECADES = 8.0  # difference between the loudest value and the floor


def _scale(decades):
    return (decades + 4) / 4


def asr_log_mel(audio: np.ndarray, num_mels: int = NUM_ASR_MELS) -> np.ndarray:
    """Compute Whisper's log-mel spectrogram of a whole clip, with column c centred on c / 100 s.

    Whisper drops the last column, which is kept here. All values lie between -1.5, which is silence, and about 2, so
    that they can be stored as float16.

    Args:
        audio: (samples,) float32 at 16 kHz, at least 1 sample.
        num_mels: number of mel bands, which must be that of the encoder.

    Returns:
        (num_mels, 1 + samples // 160) float32.
    """
    padded = np.pad(np.asarray(audio, np.float32), _FFT_SIZE // 2, mode="reflect")
    power = mel_spectrum(power_spectrum(padded, _FFT_SIZE, _HOP_LENGTH), _SAMPLE_RATE, _FFT_SIZE, num_mels)
    decades = np.log10(np.maximum(power, np.float32(_LEAST_POWER)))
    return _scale(np.maximum(decades, np.max(decades) - np.float32(_DECADES)))


def asr_columns(num_frames: int, fps: float) -> int:
    """Return the columns of a window: 228, 2.28 s, for 34 frames at 15 fps.

    It is the least even number that covers the window and has, after the encoder has halved it, a position after the
    middle of the last frame.
    """
    positions = ASR_COLUMNS_PER_SECOND / 2
    last = math.floor((num_frames - 0.5) * positions / fps)
    return 2 * max(math.ceil(num_frames * positions / fps), last + 2)


def asr_window(mel: np.ndarray, start_frame: int, num_frames: int, fps: float) -> np.ndarray:
    """Return the spectrogram of the window that starts at a frame.

    Args:
        mel: (num_mels, columns) of a whole clip, as from `asr_log_mel`.
        start_frame: first frame of the window, from 0.
        num_frames: length of the window in frames.
        fps: frames per second.

    Returns:
        (num_mels, `asr_columns`) of the type of `mel`; past the end of the clip there is the floor of the clip, which
        silence in the clip has, too.
    """
    start, columns = round(start_frame * ASR_COLUMNS_PER_SECOND / fps), asr_columns(num_frames, fps)
    window = mel[:, start : start + columns]
    missing = columns - window.shape[1]
    if not missing:
        return window
    floor = max(float(np.max(mel)) - _DECADES / 4, _scale(np.log10(_LEAST_POWER)))
    return np.pad(window, ((0, 0), (0, missing)), constant_values=floor)
