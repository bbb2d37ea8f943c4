"""Times of events: onsets of a sound, local minima of a curve, and the kernel of the distance to the nearest time."""

import contextlib
import functools
import importlib
import math
import warnings
from typing import Any, NamedTuple

import filelock
import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.files.cache import cache_folder

SIGMA = 0.1  # seconds, width of the kernel between onsets and motion beats

SILENCE_DB = -60.0  # relative to full scale; a clip in which no 64 ms are louder has no onsets

SPEECH_DB = -30.0  # level of speech relative to the loud moments
SPEECH_MARGIN = 0.3  # seconds around such sound that still count as speech

_LOUDNESS_BLOCK = 1024  # samples
_SPEECH_BLOCK = 320
_MIN_SAMPLES = 2048  # samples that the spectrogram of the onset detector needs


class Minima(NamedTuple):
    """Local minima of a curve.

    Attributes:
        sample: (n,) index of the lowest sample, of the first where two are equal.
        offset: (n,) from there to the lowest point of the parabola through it and its neighbours, -0.5 to 0.5 samples.
        rise: (n,) from the lowest sample to the nearest local maximum, on the side where that is less.
    """

    sample: np.ndarray
    offset: np.ndarray
    rise: np.ndarray


def deep_minima(curve: np.ndarray, rise: float) -> np.ndarray:
    """Return the places, between samples, of strict local minima of a curve (T,) that rise by `rise` on both sides."""
    found = minima(curve)
    return (found.sample + found.offset)[found.rise >= rise]


def minima(curve: np.ndarray, *, is_first: np.ndarray | None = None, equal: bool = False) -> Minima:
    """Find the strict local minima of one curve (T,), or of many that are concatenated.

    `is_first` (T,) tells whether a sample is the first of its curve; first and last samples are never minima. With
    `equal`, two equal lowest samples count too, as a minimum halfway between them.
    """
    is_joint = np.zeros(max(len(curve) - 1, 0), bool) if is_first is None else is_first[1:]
    steps = np.diff(curve)
    falls, rises, stays = (np.zeros(len(curve), bool) for _ in range(3))  # towards a sample, and away from it
    falls[1:], rises[:-1], stays[:-1] = (sign & ~is_joint for sign in (steps < 0, steps > 0, steps == 0))
    is_lowest = falls & rises
    if equal:
        is_lowest[:-1] |= falls[:-1] & stays[:-1] & rises[1:]
    index = np.flatnonzero(is_lowest)
    samples = np.arange(len(curve))
    left = np.maximum.accumulate(np.where(falls, 0, samples))[index]
    right = np.minimum.accumulate(np.where(rises, len(curve), samples)[::-1])[::-1][index + stays[index]]
    before, after = curve[index - 1] - curve[index], curve[index + 1] - curve[index]
    return Minima(
        index, 0.5 * (before - after) / (before + after), np.minimum(curve[left], curve[right]) - curve[index]
    )


def nearest(
    times: np.ndarray, others: np.ndarray, owners: np.ndarray | None = None, other_owners: np.ndarray | None = None
) -> np.ndarray:
    """Return the seconds (n,) from each time to the nearest of the others, infinite where there is none.

    Args:
        times, others: (n,) and (m,) ascending seconds.
        owners, other_owners: (n,) and (m,) ascending clips that the times belong to; only times of the same clip meet.
            Times then ascend within a clip. All belong to one clip by default.
    """
    if not len(others):
        return np.full(len(times), np.inf)
    if owners is None or other_owners is None:
        owners, other_owners = np.zeros(len(times), int), np.zeros(len(others), int)
    low = min(times.min(initial=0), others.min())
    span = max(times.max(initial=0), others.max()) - low + 1
    after = np.searchsorted(other_owners * span + (others - low), owners * span + (times - low))
    distances = np.full(len(times), np.inf)
    # Rounding on the joint axis may pick a neighbour that is slightly farther; distances are computed from the times.
    for neighbour in (np.maximum(after - 1, 0), np.minimum(after, len(others) - 1)):
        candidates = np.where(other_owners[neighbour] == owners, np.abs(others[neighbour] - times), np.inf)
        np.minimum(distances, candidates, out=distances)
    return distances


def kernel(distances: np.ndarray, sigma: float = SIGMA) -> np.ndarray:
    """Return exp(-d^2 / (2 sigma^2)) of distances d in seconds (HA2G, Eq. 11); 0 at infinity."""
    return np.exp(-np.square(distances) / (2 * sigma**2))


def detect_onsets(audio: np.ndarray) -> np.ndarray:
    """Return the times (n,), in seconds, of the onsets of samples at 16 kHz, by librosa's detector with defaults."""
    return librosa("onset").onset_detect(y=audio, sr=SAMPLE_RATE, units="time")


def audio_onsets(audio: np.ndarray, duration: float) -> np.ndarray:
    """Return the times in seconds, (n,), of the onsets of a clip's sound (samples,) at 16 kHz, without those of
    silence.

    There are none where the sound stays below -60 dB: the root mean square of 64 ms, relative to full scale. Sound
    after `duration`, that of the motion in seconds, is left out. This is much slower than all scores together and
    depends only on the sound: find the onsets once per clip and keep them.
    """
    sound = audio[: math.ceil(duration * SAMPLE_RATE)]
    blocks = np.pad(np.asarray(sound, np.float64), (0, -len(sound) % _LOUDNESS_BLOCK)).reshape(-1, _LOUDNESS_BLOCK)
    power = np.mean(np.square(blocks), axis=1).max(initial=0)
    if power < 10 ** (SILENCE_DB / 10):
        return np.zeros(0)
    padded = np.pad(np.asarray(sound, np.float32), (0, max(0, _MIN_SAMPLES - len(sound))))
    times = detect_onsets(padded)
    return times[times < duration]


def speech_spans(audio: np.ndarray) -> np.ndarray:
    """Return start and end in seconds, (n, 2), of the stretches of speech of samples at 16 kHz; the rest are pauses.

    Speech is everything within `SPEECH_MARGIN` of the start of 20 ms above `SPEECH_DB`, relative to the mean power
    weighted by itself, which pauses do not change.
    """
    blocks = np.asarray(audio[: len(audio) // _SPEECH_BLOCK * _SPEECH_BLOCK], np.float64).reshape(-1, _SPEECH_BLOCK)
    power = np.mean(np.square(blocks), axis=1)
    if not power.any():
        return np.zeros((0, 2))
    threshold = power @ power / power.sum() * 10 ** (SPEECH_DB / 10)
    loud = np.flatnonzero(power > threshold) * _SPEECH_BLOCK / SAMPLE_RATE
    is_last = np.append(np.diff(loud) > 2 * SPEECH_MARGIN, True)
    starts, ends = loud[np.roll(is_last, 1)] - SPEECH_MARGIN, loud[is_last] + SPEECH_MARGIN
    return np.clip(np.stack([starts, ends], axis=-1), 0, len(audio) / SAMPLE_RATE)


def cut_pauses(times: np.ndarray, spans: np.ndarray) -> np.ndarray:
    """Return the times that lie within spans (n, 2), in seconds on a clock that stops between the spans."""
    before = np.cumsum(spans[:, 1] - spans[:, 0]) - (spans[:, 1] - spans[:, 0])
    is_inside = (times[:, None] >= spans[:, 0]) & (times[:, None] < spans[:, 1])
    time, span = np.nonzero(is_inside)
    return times[time] - spans[span, 0] + before[span]


@functools.cache
def librosa(part: str) -> Any:
    """Import one module of librosa, such as "filters" or "core.spectrum", and return it.

    When a module is first imported in an environment, numba compiles functions and caches them on disk, which takes
    nearly half a minute for "onset". Processes that do so at the same time, such as workers, can corrupt this cache,
    and then every process that calls these functions ends with a segmentation fault.
    """
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(OSError, UserError):  # the home directory is read-only or missing
            cache_folder().mkdir(parents=True, exist_ok=True)
            stack.enter_context(filelock.FileLock(cache_folder() / "librosa.lock"))
        with warnings.catch_warnings():
            # Its downloader, which is never called here, would import the progress bars of notebooks.
            warnings.filterwarnings("ignore", "IProgress not found")
            return importlib.import_module(f"librosa.{part}")
