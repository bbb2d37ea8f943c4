"""Log-mel spectrograms of whole clips and of their windows: that of HA2G, and that of Whisper.

HA2G's is librosa's, whose import takes seconds because it compiles with numba: FFT 1024, hop 512, periodic Hann window,
centred frames with reflected borders, 128 mel bands of Slaney's scale and area normalisation over 0-8 kHz, power to dB.
D11: 0 dB is the maximum of the clip, the floor lies 80 dB below it; the spectrogram is computed once per clip and
sliced at the nearest column.

Whisper's (Radford et al. 2022, section 2.2), the input of a speech recognition encoder, has FFT 400, hop 160, log10 of
the power, a floor 80 dB below the loudest value, and (x + 4) / 4. As with D11, the loudest value is that of the clip
that a window is cut from, so that all windows of a clip have the same floor; Whisper takes that of its 30 s.

The end of a window that has not been heard yet is hidden, in training and in a stream: while someone speaks, a window
reaches into the future, and a model must know where its knowledge ends.
"""

import functools
import math

import numpy as np

from ha2g_jax.features.audio import SAMPLE_RATE

FFT_SIZE = 1024
HOP_LENGTH = 512
NUM_MELS = 128
FLOOR_DB = -80.0
# A clip whose loudest mel power is lower is silence: 70 dB below the noise of 16-bit rounding.
_SILENCE_POWER = 1e-15

NUM_ASR_MELS = 80  # mel bands of Whisper's models, except large-v3 and its derivatives, which have 128
ASR_COLUMNS_PER_SECOND = 100
_ASR_FFT_SIZE = 400
_ASR_HOP_LENGTH = SAMPLE_RATE // ASR_COLUMNS_PER_SECOND
_ASR_LEAST_POWER = 1e-10
_ASR_DECADES = 8.0  # difference between the loudest value and the floor

# The value of all bands of a hidden column. 0 dB is the maximum of a clip, so that no sound has it in every band, and
# silence is at the other end of the range: no further input is needed to tell them apart.
HIDDEN_DB = 0.0

_LINEAR_HZ, _LINEAR_MEL = 1000.0, 15.0  # end of the linear part of Slaney's scale
_LOG_STEP = np.log(6.4) / 27  # of the logarithm of the frequency in a mel above it
_BLOCK_BYTES = 1 << 22  # of samples that are transformed together
_NEIGHBOURS = 8  # bands that are filtered together: few enough to have few frequencies, many enough to be fast
_COLUMNS = 256  # columns that are filtered together: few enough for a single thread of BLAS


def log_mel(audio: np.ndarray, reference: float | None = None) -> np.ndarray:
    """Compute the log-mel spectrogram of a clip in dB relative to its maximum (D11).

    For a clip of ordinary loudness this is `librosa.power_to_db(melspectrogram(...), ref=np.max)`. Unlike that of
    librosa, the floor is relative to the clip, so that the result does not depend on the volume, and silence is at the
    floor and not at 0 dB. `reference` is the mel power of 0 dB, by default the maximum of the clip.

    Args:
        audio: (samples,) float32 at 16 kHz, at least 1 sample.

    Returns:
        (128, 1 + samples // 512) float32 in [-80, 0].
    """
    power = mel_power(np.pad(np.asarray(audio, np.float32), FFT_SIZE // 2, mode="reflect"))
    return decibels(power, float(np.max(power)) if reference is None else reference)


def mel_power(padded: np.ndarray) -> np.ndarray:
    """Compute the mel powers (128, 1 + (samples - 1024) // 512) float32 of sound (samples,) float32 at 16 kHz.

    Column c is that of samples 512 c to 512 c + 1023.
    """
    return mel_spectrum(power_spectrum(padded, FFT_SIZE, HOP_LENGTH), SAMPLE_RATE, FFT_SIZE, NUM_MELS)


def decibels(power: np.ndarray, reference: float) -> np.ndarray:
    """Return mel powers (128, columns) in dB relative to a reference power, in [-80, 0]; all of them -80 if the
    reference is silence.
    """
    if reference < _SILENCE_POWER:
        return np.full(power.shape, FLOOR_DB, np.float32)
    ratio = np.clip(power / np.float32(reference), 10 ** (FLOOR_DB / 10), 1)
    return np.clip(10 * np.log10(ratio), FLOOR_DB, 0, dtype=np.float32)


def sound_power(power: np.ndarray) -> float:
    """Compute the mean power of a sound, up to a constant factor.

    A band of the mel powers (128, columns) holds power per hertz (Slaney's area normalisation), so bands are weighted
    by their width.
    """
    edges = mel_frequencies(NUM_MELS + 2, SAMPLE_RATE / 2)
    widths = edges[2:] - edges[:-2]
    return float(widths @ power.mean(axis=1) / widths.sum())


def window_column(frame: int, fps: float) -> int:
    """Return the column of the spectrogram nearest to a frame's time, frame / fps x 16000 / 512, both from 0."""
    return round(frame * SAMPLE_RATE / (fps * HOP_LENGTH))


def window_columns(num_frames: int, fps: float) -> int:
    """Return the number of whole columns of the spectrogram in a window: 70 for 34 frames at 15 fps."""
    return int(num_frames * SAMPLE_RATE / (fps * HOP_LENGTH))


def mel_window(mel: np.ndarray, start_frame: int, num_frames: int, fps: float) -> np.ndarray:
    """Return the spectrogram (128, `window_columns`) of a window of a clip (128, columns) in dB.

    Past the end of the clip there is silence (-80 dB).
    """
    start, columns = window_column(start_frame, fps), window_columns(num_frames, fps)
    window = mel[:, start : start + columns]
    missing = columns - window.shape[1]
    return np.pad(window, ((0, 0), (0, missing)), constant_values=FLOOR_DB) if missing else window


def heard_columns(end_frame: int, fps: float) -> int:
    """Return how many columns of a clip's spectrogram are known when its first frames have been heard.

    Column c is centred on sample 512 c and is computed from 1024 samples, so that it needs the first 512 (c + 1)
    samples of the clip; floor(end_frame / fps x 16000) of them have been heard.
    """
    return int(end_frame * SAMPLE_RATE // (fps * HOP_LENGTH))


def hide_unheard(mel: np.ndarray, start_frame: int, heard: int, fps: float) -> np.ndarray:
    """Return the spectrogram (128, columns) of a window with `HIDDEN_DB` in the columns that need later speech.

    `start_frame` is the first frame of the window in its clip, `heard` the number of its frames whose time has passed.
    """
    known = heard_columns(start_frame + heard, fps) - window_column(start_frame, fps)
    hidden = np.array(mel)
    hidden[:, max(known, 0) :] = HIDDEN_DB
    return hidden


def _asr_scale(decades):  # type: ignore[no-untyped-def]
    return (decades + 4) / 4


def asr_log_mel(audio: np.ndarray, num_mels: int = NUM_ASR_MELS) -> np.ndarray:
    """Compute Whisper's log-mel spectrogram of a whole clip, with column c centred on c / 100 s.

    Whisper drops the last column, which is kept here. All values lie between -1.5, which is silence, and about 2, so
    that they can be stored as float16.

    Args:
        audio: (samples,) float32 at 16 kHz, at least 1 sample.
        num_mels: number of mel bands of the encoder.

    Returns:
        (num_mels, 1 + samples // 160) float32.
    """
    padded = np.pad(np.asarray(audio, np.float32), _ASR_FFT_SIZE // 2, mode="reflect")
    power = mel_spectrum(power_spectrum(padded, _ASR_FFT_SIZE, _ASR_HOP_LENGTH), SAMPLE_RATE, _ASR_FFT_SIZE, num_mels)
    decades = np.log10(np.maximum(power, np.float32(_ASR_LEAST_POWER)))
    return _asr_scale(np.maximum(decades, np.max(decades) - np.float32(_ASR_DECADES)))


def asr_columns(num_frames: int, fps: float) -> int:
    """Return the columns of a window: 228, 2.28 s, for 34 frames at 15 fps.

    It is the least even number that covers the window and has, after the encoder has halved it, a position after the
    middle of the last frame.
    """
    positions = ASR_COLUMNS_PER_SECOND / 2
    last = math.floor((num_frames - 0.5) * positions / fps)
    return 2 * max(math.ceil(num_frames * positions / fps), last + 2)


def asr_window(mel: np.ndarray, start_frame: int, num_frames: int, fps: float) -> np.ndarray:
    """Return the spectrogram (num_mels, `asr_columns`) of a window of a clip (num_mels, columns).

    Past the end of the clip there is the floor of the clip, which silence in the clip has, too.
    """
    start, columns = round(start_frame * ASR_COLUMNS_PER_SECOND / fps), asr_columns(num_frames, fps)
    window = mel[:, start : start + columns]
    missing = columns - window.shape[1]
    if not missing:
        return window
    floor = max(float(np.max(mel)) - _ASR_DECADES / 4, _asr_scale(np.log10(_ASR_LEAST_POWER)))
    return np.pad(window, ((0, 0), (0, missing)), constant_values=floor)


def power_spectrum(padded: np.ndarray, fft_size: int, hop_length: int) -> np.ndarray:
    """Compute |STFT|^2 with a periodic Hann window, `abs(librosa.stft(padded, center=False)) ** 2`.

    Args:
        padded: (samples,) float32 sound, at least `fft_size` samples; the first column begins with the first sample.

    Returns:
        (1 + fft_size // 2, 1 + (samples - fft_size) // hop_length) float32, in column-major order.
    """
    hann = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(fft_size) / fft_size)
    columns = np.lib.stride_tricks.sliding_window_view(padded, fft_size)[::hop_length]
    power = np.empty((len(columns), 1 + fft_size // 2), np.float32)
    size = _BLOCK_BYTES // (8 * fft_size)
    for start in range(0, len(columns), size):
        spectrum = np.fft.rfft(hann * columns[start : start + size]).astype(np.complex64)
        power[start : start + size] = np.square(np.abs(spectrum))
    return power.T


def mel_spectrum(power: np.ndarray, sample_rate: int, fft_size: int, num_mels: int) -> np.ndarray:
    """Filter power spectra with the triangles of the mel scale, `mel_filters(...) @ power`.

    Neighbouring bands are a product with the frequencies of these bands alone. The products have a tenth of the
    multiplications, and are too small to be divided among the threads of BLAS, which wait for each other in a loop and
    so take cores from a training step or a generation beside them.

    Args:
        power: (1 + fft_size // 2, columns) float32, from `power_spectrum`.

    Returns:
        (num_mels, columns) float32.
    """
    filters = mel_filters(sample_rate, fft_size, num_mels)
    mels = np.empty((num_mels, power.shape[1]), np.float32)
    for start in range(0, power.shape[1], _COLUMNS):
        columns = slice(start, start + _COLUMNS)
        for bands, frequencies in _groups(sample_rate, fft_size, num_mels):
            np.matmul(filters[bands, frequencies], power[frequencies, columns], out=mels[bands, columns])
    return mels


@functools.cache
def _groups(sample_rate: int, fft_size: int, num_mels: int) -> list[tuple[slice, slice]]:
    """Return the neighbouring bands that are filtered together, and the frequencies that they cover."""
    filters = mel_filters(sample_rate, fft_size, num_mels)
    groups = []
    for first in range(0, num_mels, _NEIGHBOURS):
        bands = slice(first, first + _NEIGHBOURS)
        covered = np.flatnonzero(filters[bands].any(axis=0))
        groups.append((bands, slice(covered[0], covered[-1] + 1)))
    return groups


@functools.cache
def mel_filters(sample_rate: int, fft_size: int, num_mels: int) -> np.ndarray:
    """Return triangles on Slaney's mel scale from 0 to half the sample rate, each of area 1, `librosa.filters.mel`.

    Returns:
        (num_mels, 1 + fft_size // 2) float32.
    """
    edges = mel_frequencies(num_mels + 2, sample_rate / 2)
    distances, widths = edges[:, None] - np.fft.rfftfreq(fft_size, 1 / sample_rate), np.diff(edges)[:, None]
    triangles = np.minimum(-distances[:-2] / widths[:-1], distances[2:] / widths[1:])
    triangles = np.maximum(triangles, 0).astype(np.float32)
    return (triangles * (2 / (edges[2:] - edges[:-2]))[:, None]).astype(np.float32)


def mel_frequencies(count: int, highest: float) -> np.ndarray:
    """Return frequencies in Hz, (count,), evenly spaced on Slaney's mel scale from 0 to `highest`, at least 1000;
    `librosa.mel_frequencies`.
    """
    mels = np.linspace(0, _LINEAR_MEL + np.log(highest / _LINEAR_HZ) / _LOG_STEP, count)
    return np.where(
        mels < _LINEAR_MEL,
        mels * (_LINEAR_HZ / _LINEAR_MEL),
        _LINEAR_HZ * np.exp(_LOG_STEP * (mels - _LINEAR_MEL)),
    )
