"""Cues of speech and the strokes that they cause: key poses from syllables, loudness, pitch, phrases and words.

Every level is relative to the recording's own loudness and noise floor, for recorded and for synthetic speech.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy import ndimage, signal

from ha2g_jax.data.talk import lexicon
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.features.text import Word

RATE = 100  # cues per second

_WINDOW, _HOP, _FFT = 640, SAMPLE_RATE // RATE, 1280
_VOICE_BAND = (200.0, 4000.0)
_PITCH_RANGE = (70.0, 400.0)
_SILENT_DB = -60.0  # mean power of the loud frames, relative to full scale
_MIN_PAUSE = 0.2
_ACCENT_GAP = 0.6

LATENCY = 0.06  # seconds by which gestures are late or early at either end of the style's range
_BEAT_GAP = 0.5
WEAKEST_BEAT = 0.75
_LIVELY_SECONDS = 4.0
_USUAL_LOUDNESS, _USUAL_PITCH = 0.163, 2.2  # standard deviations over syllables
_RISE, _REST, _REBOUND, _BEYOND = 0.48, 0.03, 0.32, 0.08
_HOLD = 0.55


class Cues(NamedTuple):
    """Acoustic cues of a recording; tracks have `RATE` values per second, times are in seconds.

    Attributes:
        loudness: (n,) 0 at the noise floor, 1 at the loud syllables.
        nuclei: (k, 2) time and loudness of each syllable nucleus.
        pitch: (n,) semitones above the speaker's median pitch, smooth, held through unvoiced stretches.
        accents: (a, 2) time and size in semitones of each rise of the pitch to a peak.
        pauses: (p, 2) start and end of each pause between two phrases.
    """

    loudness: np.ndarray
    nuclei: np.ndarray
    pitch: np.ndarray
    accents: np.ndarray
    pauses: np.ndarray


def find_cues(audio: np.ndarray) -> Cues:
    """Find the acoustic cues of speech (samples,) at 16 kHz; silence gives flat tracks and no events."""
    padded = np.pad(audio.astype(np.float32), (_WINDOW // 2, _WINDOW // 2 + _HOP))
    frames = np.lib.stride_tricks.sliding_window_view(padded, _WINDOW)[: len(audio) + 1 : _HOP]
    power = np.abs(np.fft.rfft(frames * np.hanning(_WINDOW).astype(np.float32), _FFT)) ** 2
    loudness, nuclei = _syllables(power)
    pitch, voiced = _pitch(power, loudness)
    rises, properties = signal.find_peaks(np.where(voiced, pitch, -24), prominence=1.0, distance=_ACCENT_GAP * RATE)
    sizes = np.minimum(properties["prominences"], 6.0)
    return Cues(loudness, nuclei, pitch, np.stack([rises / RATE, sizes], axis=-1), _pauses(loudness))


def _syllables(power: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
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
    ends_of_sound = edges[~speaking[edges + 1]]
    starts_of_sound = edges[speaking[edges + 1]]
    pauses = [
        (start, later[0])
        for start in ends_of_sound
        if len(later := starts_of_sound[starts_of_sound > start]) and later[0] - start >= _MIN_PAUSE * RATE
    ]
    return np.array(pauses, float).reshape(-1, 2) / RATE


class Beat(NamedTuple):
    """A beat of the hands, highest at the apex and lowest at the hit, in seconds, with the loudness of the syllable
    that causes it and its pitch, in semitones above the speaker's median pitch.
    """

    apex: float
    hit: float
    loudness: float
    pitch: float


class WordGesture(NamedTuple):
    """A gesture of a word, in seconds: preparation from start to ready, hold from peak to release, then retraction."""

    word_class: str
    start: float
    ready: float
    peak: float
    release: float
    end: float


def liveliness(cues: Cues, moments: np.ndarray) -> np.ndarray:
    """Return the liveliness of the speech around times (n,) in seconds: 1 on average, from 0.6 to 1.6.

    It is the spread of the loudness and of the pitch of the syllables within a few seconds.
    """
    times, loudness = cues.nuclei.T
    if not len(times):
        return np.ones(len(moments))
    pitch = cues.pitch[np.minimum(np.round(times * RATE).astype(int), len(cues.pitch) - 1)]
    weights = np.exp(-((moments[:, None] - times) ** 2) / (2 * _LIVELY_SECONDS**2)) + 1e-3
    weights /= weights.sum(axis=1, keepdims=True)
    spreads = [
        np.maximum(np.sqrt(np.maximum(weights @ track**2 - (weights @ track) ** 2, 0)) / usual, 0.2)
        for track, usual in ((loudness, _USUAL_LOUDNESS), (pitch, _USUAL_PITCH))
    ]
    return np.clip(spreads[0] ** 1.2 * spreads[1] ** 0.25, 0.6, 1.6)


def track(times: np.ndarray, keys: Sequence[tuple[float, npt.ArrayLike]]) -> np.ndarray:
    """Interpolate key poses by minimum-jerk movement, x = a + (b - a)(10 u^3 - 15 u^4 + 6 u^5).

    The keys are (time, value) pairs in order of time, whose values are numbers or (D,) vectors. The result at times
    (T,) in seconds, (T,) or (T, D), is at rest at each key; the first and the last key are held outside their times.
    """
    moments = np.array([moment for moment, _ in keys])
    values = np.array([value for _, value in keys], float)
    after = np.clip(np.searchsorted(moments, times), 1, len(keys) - 1) if len(keys) > 1 else np.zeros(len(times), int)
    before = np.maximum(after - 1, 0)
    length = np.maximum(moments[after] - moments[before], 1e-3)
    u = np.clip((times - moments[before]) / length, 0, 1)
    blend = u**3 * (10 - 15 * u + 6 * u**2)
    blend = blend.reshape(-1, *[1] * (values.ndim - 1))
    return values[before] + (values[after] - values[before]) * blend


def plan_beats(cues: Cues, latency: float) -> tuple[Beat, ...]:
    """Choose the loud syllables that cause a beat, at most one in 0.5 seconds, louder ones first, in order of time."""
    chosen: list[np.ndarray] = []
    for nucleus in cues.nuclei[np.argsort(-cues.nuclei[:, 1], kind="stable")]:
        if nucleus[1] >= WEAKEST_BEAT and all(abs(nucleus[0] - other[0]) >= _BEAT_GAP for other in chosen):
            chosen.append(nucleus)
    beats = []
    last = -np.inf
    for moment, loudness in sorted(tuple(nucleus) for nucleus in chosen):
        hit = moment + latency
        # A stroke soon after another is quicker, but never too quick for the frame rate to show it.
        stroke = np.clip(0.5 * (hit - last), 0.24, 0.30)
        pitch = float(cues.pitch[min(round(moment * RATE), len(cues.pitch) - 1)])
        beats.append(Beat(hit - stroke, hit, loudness, pitch))
        last = hit
    return tuple(beats)


def beat_keys(beats: Sequence[Beat], sizes: np.ndarray) -> list[tuple[float, np.ndarray]]:
    """Return the keys, for `track`, of the offsets of a hand that beats.

    The offset of each beat at its apex is a row of `sizes` (beats, D); at the hit the hand is a little beyond rest.
    """
    none = np.zeros(sizes.shape[1])
    keys = [(-1.0, none)]
    for beat, size in zip(beats, sizes, strict=True):
        rise = beat.apex - _RISE
        if rise > keys[-1][0]:
            keys.append((rise, none))
        elif len(keys) > 1 and beat.apex < keys[-1][0] + 0.12:
            keys.pop()  # co-articulation: the next stroke is prepared from where this one ended
        keys += [(beat.apex, size), (beat.hit - _REST, -_BEYOND * size), (beat.hit + _REST, -_BEYOND * size)]
        keys.append((beat.hit + _REBOUND, none))
    return keys


def plan_word_gestures(words: Sequence[Word], latency: float) -> tuple[WordGesture, ...]:
    """Plan a gesture for each word that carries one; it is prepared before the word's onset and held after it."""
    onsets = [(word.start, lexicon.word_class(word.text)) for word in words if lexicon.word_class(word.text)]
    peaks = [onset + latency + 0.12 for onset, _ in onsets]
    gestures = []
    for index, ((_, word_class), peak) in enumerate(zip(onsets, peaks, strict=True)):
        following = peaks[index + 1] if index + 1 < len(peaks) else np.inf
        release = min(peak + _HOLD, max(following - 0.45, peak + 0.07))
        earliest = gestures[-1].release + 0.12 if gestures else -np.inf
        gestures.append(WordGesture(word_class, peak - 0.62, max(peak - 0.24, earliest), peak, release, release + 0.5))
    return tuple(gestures)


def gesture_keys(gestures: Sequence[WordGesture], ready: Sequence, peak: Sequence) -> tuple[list, list]:
    """Return the keys, for `track`, of the weight of the gestures (0 or 1) and of their value.

    The value of each gesture is `ready` at the end of its preparation, and `peak` while it is held.
    """
    weight: list[tuple[float, float]] = [(-1.0, 0.0)]
    value: list[tuple[float, Sequence[float]]] = []
    for index, gesture in enumerate(gestures):
        linked = index > 0 and gestures[index - 1].end > gesture.start
        if linked:
            weight.pop()  # the hand moves straight to the next gesture and does not return to rest
            weight.append((gesture.ready, 1.0))
        else:
            weight += [(gesture.start, 0.0), (gesture.ready, 1.0)]
            value.append((gesture.start, ready[index]))
        weight += [(gesture.release, 1.0), (gesture.end, 0.0)]
        value += [(gesture.ready, ready[index]), (gesture.peak, peak[index]), (gesture.release, peak[index])]
    return in_order(weight), in_order(value)


def plan_posture(pauses: np.ndarray) -> list[tuple[float, float]]:
    """Return the keys, for `track`, of the lean in [-1, 1], which changes sides in the first second of each pause."""
    keys = [(-1.0, 0.7)]
    side = -1.0
    for start, end in pauses:
        keys += [
            (start + 0.05, keys[-1][1]),
            (min(end + 0.25, start + 1.0), side * np.clip(0.5 + 0.6 * (end - start), 0.6, 1.0)),
        ]
        side = -side
    return in_order(keys)


def in_order(keys: list) -> list:
    """Return keys whose times never decrease: a time before an earlier one is set to it."""
    if not keys:
        return keys
    moments = np.maximum.accumulate([moment for moment, _ in keys])
    return [(float(moment), value) for moment, (_, value) in zip(moments, keys, strict=True)]
