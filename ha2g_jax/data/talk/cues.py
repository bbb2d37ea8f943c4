"""Acoustic cues of speech that do not depend on the words: syllables, loudness, pitch and phrases.

All of them come from one short-time spectrum, and every level is relative to the recording's own
loudness and noise floor, so that recorded speech works as well as synthetic speech.
"""

from typing import NamedTuple

import numpy as np
from scipy import ndimage, signal

SAMPLE_RATE = 16000
RATE = 100  # cues per second

_WINDOW, _HOP, _FFT = 640, SAMPLE_RATE // RATE, 1280
_VOICE_BAND = (200.0, 4000.0)
_PITCH_RANGE = (70.0, 400.0)
_SILENT_DB = -60.0  # mean power of the loud frames, relative to full scale
_MIN_PAUSE = 0.2
_ACCENT_GAP = 0.6


class Cues(NamedTuple):
    """Acoustic cues of a recording; tracks have `RATE` values per second, times are in seconds.

    Attributes:
        loudness: (n,) 0 at the noise floor, 1 at the loud syllables.
        nuclei: (k, 2) time and loudness of each syllable nucleus.
        pitch: (n,) semitones above the speaker's middle pitch, smooth, held through unvoiced stretches.
        accents: (a, 2) time and size in semitones of each rise of the pitch to a peak.
        pauses: (p, 2) start and end of each pause between two phrases.
    """

    loudness: np.ndarray
    nuclei: np.ndarray
    pitch: np.ndarray
    accents: np.ndarray
    pauses: np.ndarray


def find_cues(audio: np.ndarray) -> Cues:
    """Find the acoustic cues of speech; silence gives flat tracks and no events.

    Args:
        audio: (samples,) float32 at 16 kHz.

    Returns:
        The cues, with n = 1 + samples // 160 values per track.
    """
    padded = np.pad(audio.astype(np.float32), (_WINDOW // 2, _WINDOW // 2 + _HOP))
    frames = np.lib.stride_tricks.sliding_window_view(padded, _WINDOW)[: len(audio) + 1 : _HOP]
    power = np.abs(np.fft.rfft(frames * np.hanning(_WINDOW).astype(np.float32), _FFT)) ** 2
    loudness, nuclei = _syllables(power)
    pitch, voiced = _pitch(power, loudness)
    rises, properties = signal.find_peaks(np.where(voiced, pitch, -24), prominence=1.0, distance=_ACCENT_GAP * RATE)
    sizes = np.minimum(properties["prominences"], 6.0)
    return Cues(loudness, nuclei, pitch, np.stack([rises / RATE, sizes], axis=-1), _pauses(loudness))


def _syllables(power: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the loudness between 0 and 1 and its peaks, the syllable nuclei."""
    low, high = (int(edge * _FFT / SAMPLE_RATE) for edge in _VOICE_BAND)
    band = ndimage.gaussian_filter1d(power[:, low:high].sum(axis=-1, dtype=np.float64), 0.025 * RATE)
    level = 10 * np.log10(band / (_WINDOW * _FFT / 4) + 1e-12)
    if (loud := np.percentile(level, 95)) < _SILENT_DB:
        return np.zeros(len(level)), np.zeros((0, 2))
    floor = max(np.percentile(level, 5) + 6, loud - 26)
    loudness = np.clip((level - floor) / max(loud - floor, 8.0), 0, 1.15)
    smooth = ndimage.gaussian_filter1d(loudness, 0.02 * RATE)
    peaks, _ = signal.find_peaks(smooth, prominence=0.08, height=0.3)
    return loudness, np.stack([peaks / RATE, smooth[peaks]], axis=-1)


def _pitch(power: np.ndarray, loudness: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the smooth pitch in semitones around its median, and where it is voiced, by autocorrelation."""
    shortest, longest = (int(SAMPLE_RATE / frequency) for frequency in reversed(_PITCH_RANGE))
    correlation = np.fft.irfft(power)[:, : longest + 1]
    window = np.fft.irfft(np.abs(np.fft.rfft(np.hanning(_WINDOW), _FFT)) ** 2)[: longest + 1]
    strength = correlation[:, shortest:] / (correlation[:, :1] + 1e-9) * (window[0] / window[shortest:])
    # A small penalty on long lags, because a voice also repeats at twice its period.
    lags = np.arange(shortest, longest + 1)
    best = np.argmax(strength - 0.1 * lags / longest, axis=-1)
    voiced = (strength[np.arange(len(best)), best] > 0.45) & (loudness > 0.15)
    if voiced.sum() < 0.1 * RATE:
        return np.zeros(len(power)), np.zeros(len(power), bool)
    semitones = -12 * np.log2(lags[best])
    semitones = ndimage.median_filter(np.where(voiced, semitones, np.median(semitones[voiced])), 7)
    semitones = np.clip(semitones - np.median(semitones[voiced]), -9, 9)
    times = np.arange(len(power))
    held = np.interp(times, times[voiced], semitones[voiced])
    return ndimage.gaussian_filter1d(held, 0.08 * RATE), voiced


def _pauses(loudness: np.ndarray) -> np.ndarray:
    """Return the starts and ends of the silences between the first and the last sound."""
    speaking = ndimage.gaussian_filter1d((loudness > 0.12).astype(float), 0.03 * RATE) > 0.5
    edges = np.flatnonzero(np.diff(speaking.astype(int)))
    ends_of_sound = edges[: len(edges)][~speaking[edges + 1]]
    starts_of_sound = edges[speaking[edges + 1]]
    pauses = [
        (start, later[0])
        for start in ends_of_sound
        if len(later := starts_of_sound[starts_of_sound > start]) and later[0] - start >= _MIN_PAUSE * RATE
    ]
    return np.array(pauses, float).reshape(-1, 2) / RATE
