"""Log-mel spectrograms of whole clips and of their windows, for HA2G and for Whisper.

That of HA2G is the one of librosa, which is not used because it takes seconds to import: FFT 1024, hop 512, periodic
Hann window, centred frames, 128 mel bands of Slaney's scale and area normalisation over 0-8 kHz, power to dB.
Frequencies below 80 Hz are removed: no voice contains a constant offset, rumble or the hum of the mains. Slow sines are
subtracted before the transform, because the Hann window spreads them over all frequencies. The first and the last
column, which reach beyond the ends of the sound, are silence: otherwise sound cut in the middle of a wave would click.
D11: 0 dB is the maximum of the clip and the floor is 80 dB below it; the spectrogram is computed once per clip and
sliced at the nearest column. 0 dB is at least the level of a quiet voice, `LEAST_POWER`, so that faint noise alone does
not look as loud as speech.

Whisper's (Radford et al. 2022, section 2.2), the input of a speech recognition encoder, has FFT 400, hop 160, log10 of
the power, a floor 80 dB below the loudest value, and (x + 4) / 4. As with D11, the loudest value is that of the clip
that a window is cut from, so that all windows of a clip have the same floor; Whisper takes that of its 30 s. Only the
floor is relative.

In a stream a window reaches into the future, so the part of it that has not been heard yet is hidden with a special
value. Training hides ends of windows in the same way, so that the model learns where the known speech ends.
"""

import functools
import math

import numpy as np

from ha2g_jax.features.audio import LOWEST_HZ, SAMPLE_RATE

FFT_SIZE = 1024
HOP_LENGTH = 512
NUM_MELS = 128
FLOOR_DB = -80.0
_FIRST_HEARD = math.ceil(LOWEST_HZ * FFT_SIZE / SAMPLE_RATE)  # index of a frequency of the FFT
_SLOW_CYCLES = np.arange(0, 3, 0.5)  # cycles in a column; the fastest, 39 Hz, reaches frequencies up to `_FIRST_HEARD`

NUM_ASR_MELS = 80  # mel bands of Whisper's models, except large-v3 and its derivatives, which have 128
ASR_COLUMNS_PER_SECOND = 100
_ASR_FFT_SIZE = 400
_ASR_HOP_LENGTH = SAMPLE_RATE // ASR_COLUMNS_PER_SECOND
_ASR_LEAST_POWER = 1e-10
_ASR_DECADES = 8.0  # difference between the loudest value and the floor

# Value of all bands of a hidden column. 0 dB is the maximum of a clip, so that no sound has it in every band, and
# silence is at the other end of the range; the model needs no further input to tell them apart.
HIDDEN_DB = 0.0

# The loudest mel power of speech with a peak of about 0.2: 12 to 37 in four recordings. A stream begins with this 0 dB,
# so that the noise before the first word is not taken for speech, and louder speech raises it at once.
TYPICAL_POWER = 15.0
# The least mel power of 0 dB, 30 dB lower: that of speech with a peak of about 0.006, -44 dBFS, or of white noise at
# -42 dBFS. All of a quieter clip is below 0 dB.
LEAST_POWER = TYPICAL_POWER / 1000
# In a stream 0 dB falls slowly while there is sound, so that one loud moment is forgotten after some minutes and a
# quiet voice is heard; it does not fall in pauses.
_FALL_DB = 0.2  # per second of sound
_SOUND_DB = -30.0  # a column whose loudest band is louder is sound

_FALL = 10 ** (-_FALL_DB / 10 * HOP_LENGTH / SAMPLE_RATE)

_LINEAR_HZ, _LINEAR_MEL = 1000.0, 15.0  # end of the linear part of Slaney's scale
_LOG_STEP = np.log(6.4) / 27  # step of the logarithm of the frequency for each mel above it
_BLOCK_BYTES = 1 << 18  # bytes of samples that are transformed together: few enough for a single thread of BLAS
_NEIGHBOURS = 8  # bands that are filtered together: few enough to share few frequencies, many enough to be fast
_COLUMNS = 256  # columns that are filtered together: few enough for a single thread of BLAS


def log_mel(audio: np.ndarray, reference: float | None = None) -> np.ndarray:
    """Compute the log-mel spectrogram (128, 1 + samples // 512) float32 in [-80, 0] dB of a clip (samples,) at 16 kHz.

    For a clip of ordinary loudness this is `librosa.power_to_db(melspectrogram(...), ref=np.max)` between the first and
    the last column, which are silence. Unlike that of librosa, the floor is relative to the clip (D11), so that the
    result does not depend on the volume. `reference` is the mel power of 0 dB, by default the maximum of the clip, and
    at least `LEAST_POWER`, so that quieter sound stays below 0 dB. A clip that nowhere comes within 30 dB of 0 dB is
    silence, as in a stream.
    """
    power = np.zeros((NUM_MELS, 1 + len(audio) // HOP_LENGTH), np.float32)
    if len(audio) >= FFT_SIZE:
        power[:, 1:-1] = mel_power(np.asarray(audio, np.float32))
    mel = decibels(power, float(np.max(power)) if reference is None else reference)
    return mel if mel.max() > _SOUND_DB else np.full_like(mel, FLOOR_DB)


def mel_power(audio: np.ndarray) -> np.ndarray:
    """Compute the mel powers (128, 1 + (samples - 1024) // 512) float32 of sound (samples,) float32 at 16 kHz.

    Column c covers samples 512 c to 512 c + 1023.
    """
    power = power_spectrum(audio, FFT_SIZE, HOP_LENGTH, _slow_sines())
    power[:_FIRST_HEARD] = 0
    return mel_spectrum(power, NUM_MELS)


def decibels(power: np.ndarray, reference: float) -> np.ndarray:
    """Return mel powers, such as (128, columns), in dB relative to a reference power of at least `LEAST_POWER`.

    They are in [-80, 0], float32.
    """
    ratio = np.clip(power / np.float32(max(reference, LEAST_POWER)), 10 ** (FLOOR_DB / 10), 1)
    return np.clip(10 * np.log10(ratio), FLOOR_DB, 0, dtype=np.float32)


def sound_power(power: np.ndarray) -> float:
    """Compute the mean power of a sound, up to a constant factor, from its mel powers (128, columns) per hertz."""
    edges = mel_frequencies(NUM_MELS + 2)
    widths = edges[2:] - edges[:-2]
    return float(widths @ power.mean(axis=1) / widths.sum())


def window_column(frame: float, fps: float) -> int:
    """Return the column of the spectrogram nearest to a frame's time, frame / fps x 16000 / 512, both from 0."""
    return round(frame * SAMPLE_RATE / (fps * HOP_LENGTH))


def window_columns(num_frames: int, fps: float) -> int:
    """Return the number of whole columns of the spectrogram in a window: 70 for 34 frames at 15 fps."""
    return int(num_frames * SAMPLE_RATE / (fps * HOP_LENGTH))


def mel_window(mel: np.ndarray, start_frame: int, num_frames: int, fps: float) -> np.ndarray:
    """Return the spectrogram (128, `window_columns`) of a window of a clip in dB, -80 past the end of the clip."""
    start, columns = window_column(start_frame, fps), window_columns(num_frames, fps)
    window = mel[:, start : start + columns]
    missing = columns - window.shape[1]
    return np.pad(window, ((0, 0), (0, missing)), constant_values=FLOOR_DB) if missing else window


def heard_columns(end_frame: int, fps: float) -> int:
    """Return how many columns of a clip's spectrogram are known when its first `end_frame` frames have been heard.

    Column c needs the first 512 (c + 1) samples; floor(end_frame / fps x 16000) of them have been heard.
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
    """Compute Whisper's log-mel spectrogram (num_mels, 1 + samples // 160) float32 of a clip (samples,) at 16 kHz.

    Column c is centred on c / 100 s; Whisper drops the last one, which is kept here. All values lie between -1.5, which
    is silence, and about 2, so that they can be stored as float16.
    """
    padded = np.pad(np.asarray(audio, np.float32), _ASR_FFT_SIZE // 2, mode="reflect")
    power = mel_spectrum(power_spectrum(padded, _ASR_FFT_SIZE, _ASR_HOP_LENGTH), num_mels)
    decades = np.log10(np.maximum(power, np.float32(_ASR_LEAST_POWER)))
    return _asr_scale(np.maximum(decades, np.max(decades) - np.float32(_ASR_DECADES)))


def asr_columns(num_frames: int, fps: float) -> int:
    """Return the columns of a window: 228, 2.28 s, for 34 frames at 15 fps.

    It is the least even number that covers the window and leaves, after the encoder has halved it, a position after
    the middle of the last frame.
    """
    positions = ASR_COLUMNS_PER_SECOND / 2
    last = math.floor((num_frames - 0.5) * positions / fps)
    return 2 * max(math.ceil(num_frames * positions / fps), last + 2)


def asr_window(mel: np.ndarray, start_frame: int, num_frames: int, fps: float) -> np.ndarray:
    """Return the spectrogram (num_mels, `asr_columns`) of a window of a clip, the clip's floor past its end."""
    start, columns = round(start_frame * ASR_COLUMNS_PER_SECOND / fps), asr_columns(num_frames, fps)
    window = mel[:, start : start + columns]
    missing = columns - window.shape[1]
    if not missing:
        return window
    floor = max(float(np.max(mel)) - _ASR_DECADES / 4, _asr_scale(np.log10(_ASR_LEAST_POWER)))
    return np.pad(window, ((0, 0), (0, missing)), constant_values=floor)


def power_spectrum(audio: np.ndarray, fft_size: int, hop_length: int, without: np.ndarray | None = None) -> np.ndarray:
    """Compute |STFT|^2 with a periodic Hann window, `abs(librosa.stft(audio, center=False)) ** 2`.

    The sound is (samples,) float32, of at least `fft_size` samples, and the first column begins with the first of them.
    The result (1 + fft_size // 2, 1 + (samples - fft_size) // hop_length) is float32 in column-major order. From
    the windowed samples of a column their projection on orthonormal vectors `without` (fft_size, n) is subtracted.
    """
    hann = _hann(fft_size)
    columns = np.lib.stride_tricks.sliding_window_view(audio, fft_size)[::hop_length]
    power = np.empty((len(columns), 1 + fft_size // 2), np.float32)
    size = _BLOCK_BYTES // (8 * fft_size)
    for start in range(0, len(columns), size):
        windowed = hann * columns[start : start + size]
        if without is not None:
            windowed -= windowed @ without @ without.T
        power[start : start + size] = np.square(np.abs(np.fft.rfft(windowed).astype(np.complex64)))
    return power.T


@functools.cache
def _hann(size: int) -> np.ndarray:
    return 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(size) / size)


@functools.cache
def _slow_sines() -> np.ndarray:
    """Return orthonormal vectors (1024, 11) that span the windowed sines of `_SLOW_CYCLES` of any phase."""
    phases = 2 * np.pi * np.arange(FFT_SIZE)[:, None] / FFT_SIZE * _SLOW_CYCLES
    sines = np.concatenate([np.cos(phases), np.sin(phases[:, 1:])], axis=1)
    return np.linalg.qr(_hann(FFT_SIZE)[:, None] * sines).Q


def mel_spectrum(power: np.ndarray, num_mels: int) -> np.ndarray:
    """Filter power spectra (1 + fft_size // 2, columns) to (num_mels, columns) float32, `mel_filters(...) @ power`.

    Each group of neighbouring bands is one product with only the frequencies of these bands. This takes a tenth of the
    multiplications, and the products are too small for BLAS to use several threads, whose busy waiting would take
    cores from a training step or a generation that runs at the same time.
    """
    fft_size = 2 * (len(power) - 1)
    filters = mel_filters(fft_size, num_mels)
    mels = np.empty((num_mels, power.shape[1]), np.float32)
    for start in range(0, power.shape[1], _COLUMNS):
        columns = slice(start, start + _COLUMNS)
        for bands, frequencies in _groups(fft_size, num_mels):
            np.matmul(filters[bands, frequencies], power[frequencies, columns], out=mels[bands, columns])
    return mels


@functools.cache
def _groups(fft_size: int, num_mels: int) -> list[tuple[slice, slice]]:
    """Return the neighbouring bands that are filtered together, and the frequencies that they cover."""
    filters = mel_filters(fft_size, num_mels)
    groups = []
    for first in range(0, num_mels, _NEIGHBOURS):
        bands = slice(first, first + _NEIGHBOURS)
        covered = np.flatnonzero(filters[bands].any(axis=0))
        groups.append((bands, slice(covered[0], covered[-1] + 1)))
    return groups


@functools.cache
def mel_filters(fft_size: int, num_mels: int) -> np.ndarray:
    """Return triangles (num_mels, 1 + fft_size // 2) float32 of area 1 on Slaney's mel scale, `librosa.filters.mel`."""
    edges = mel_frequencies(num_mels + 2)
    distances, widths = edges[:, None] - np.fft.rfftfreq(fft_size, 1 / SAMPLE_RATE), np.diff(edges)[:, None]
    triangles = np.minimum(-distances[:-2] / widths[:-1], distances[2:] / widths[1:])
    triangles = np.maximum(triangles, 0).astype(np.float32)
    return (triangles * (2 / (edges[2:] - edges[:-2]))[:, None]).astype(np.float32)


def mel_frequencies(count: int) -> np.ndarray:
    """Return frequencies in Hz, (count,), evenly spaced on Slaney's mel scale, 0-8 kHz; `librosa.mel_frequencies`."""
    mels = np.linspace(0, _LINEAR_MEL + np.log(SAMPLE_RATE / 2 / _LINEAR_HZ) / _LOG_STEP, count)
    return np.where(
        mels < _LINEAR_MEL,
        mels * (_LINEAR_HZ / _LINEAR_MEL),
        _LINEAR_HZ * np.exp(_LOG_STEP * (mels - _LINEAR_MEL)),
    )


class RunningMel:
    """The last `num_columns` of the spectrogram of speech that arrives in pieces, in constant memory.

    They are those of `log_mel`, but 0 dB is the mel power `reference` or, because the maximum of a clip is not known
    before its end, a running level that starts at `TYPICAL_POWER`. Each window uses its current value.
    """

    def __init__(self, num_columns: int, reference: float | None = None):
        self._reference = TYPICAL_POWER if reference is None else reference
        self._is_running = reference is None
        self._powers = np.zeros((num_columns, NUM_MELS), np.float32)  # the latest column last; silence before the first
        self._is_sound = np.zeros(num_columns, bool)  # of the same columns
        self.restart(0)

    def restart(self, num_samples: int) -> None:
        """Replace all sound so far by `num_samples` samples of silence; the level of 0 dB stays."""
        self._powers[:], self._is_sound[:] = 0, False
        self._num_columns = max(num_samples // HOP_LENGTH, 1)  # since the start; the first one is silence
        self._first = HOP_LENGTH * (self._num_columns - 1)  # number of the first of the samples for later columns
        self._samples = np.zeros(num_samples - self._first, np.float32)

    def add(self, samples: np.ndarray) -> None:
        """Add samples (samples,) float32 at 16 kHz to the end, and compute the columns that they complete."""
        self._samples = np.concatenate([self._samples, samples])
        while HOP_LENGTH * (self._num_columns + 1) <= self._first + len(self._samples):
            start = HOP_LENGTH * (self._num_columns - 1) - self._first
            self._add_column(self._samples[start : start + FFT_SIZE])
        done = HOP_LENGTH * (self._num_columns - 1) - self._first
        self._samples, self._first = self._samples[done:].copy(), self._first + done

    def window(self, start: int, columns: int) -> np.ndarray:
        """Return columns (128, columns) float32 dB at the precision of `data.speech`, silence where there are none."""
        end = start + columns
        known = min(max(end, start), self._num_columns)
        first = len(self._powers) - self._num_columns + start
        powers = np.zeros((columns, NUM_MELS), np.float32)
        powers[: max(known - start, 0)] = self._powers[first : first + max(known - start, 0)]
        return decibels(powers.T, self._reference).astype(np.float16).astype(np.float32)

    def has_sound(self, start: int, end: int) -> bool:
        """Return whether one of the kept columns from `start` on and before `end` is within 30 dB of 0 dB.

        As 0 dB is at least `LEAST_POWER`, white noise below -72 dBFS never is, no matter what was heard before.
        """
        first = len(self._is_sound) - self._num_columns
        return bool(self._is_sound[max(first + start, 0) : max(first + end, 0)].any())

    def _add_column(self, samples: np.ndarray) -> None:
        power = mel_power(samples)[:, 0]
        loudest = float(power.max())
        is_sound = bool(decibels(power, self._reference).max() > _SOUND_DB)
        for kept, latest in ((self._powers, power), (self._is_sound, is_sound)):
            kept[:-1] = kept[1:]
            kept[-1] = latest
        self._num_columns += 1
        if self._is_running and is_sound:
            self._reference = max(loudest, self._reference * _FALL)
