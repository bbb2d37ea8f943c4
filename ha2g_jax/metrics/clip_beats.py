"""The motion beats and the onsets of clips, which beat alignment compares."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ha2g_jax.metrics import beats

THRESHOLD = 0.03  # rise of the angle change rate on both sides of a motion beat
FIRST_FRAME = 4  # frames before it are the seed poses
SILENCE_DB = -60.0  # re full scale: a clip no 64 ms of which are louder has no onsets

_LOUDNESS_BLOCK = 1024  # samples
_MIN_SAMPLES = 2048  # that the onset detector's spectrogram needs


class Clip(NamedTuple):
    """What beat alignment knows of a motion and its sound.

    Attributes:
        beats: (m,) seconds of the motion beats.
        onsets: (k,) seconds of the onsets of the sound.
        start, end: seconds; what lies outside is not scored, and is no neighbour either.
    """

    beats: np.ndarray
    onsets: np.ndarray
    start: float
    end: float


def motion_beats(
    rate: np.ndarray, fps: float, first_frame: int = FIRST_FRAME, threshold: float = THRESHOLD
) -> np.ndarray:
    """Times in seconds, (n,), at which a motion stops: local minima of its angle change rate.

    The rate rises on both sides, to the nearest local maximum there, by at least the threshold. A parabola through the
    minimum and its neighbours places it between frames. Minima are strict, but for two equal samples, as a stop right
    on a frame makes them. A pose held without any change for longer is no motion beat.

    Args:
        rate: (T - 1,) of `angle_change_rate`, of the whole motion.
        fps: frames per second.
        first_frame: only frames from this one on are looked at.
        threshold: least rise; the rate has no unit and is about 1 on average.
    """
    times, _, rise = find_stops([rate], fps, first_frame)
    return times[rise >= threshold]


def audio_onsets(audio: np.ndarray, duration: float) -> np.ndarray:
    """Times in seconds, (n,), of the onsets of a clip's sound, found by librosa's detector with its defaults.

    None where the sound stays under -60 dB: the root mean square of 64 ms, re full scale. Much slower than all scores
    together, and a matter of the sound alone: find them once per clip and keep them.

    Args:
        audio: (samples,) at 16 kHz.
        duration: seconds of the motion; what sounds later is left out.
    """
    sound = audio[: math.ceil(duration * beats.ONSET_RATE)]
    blocks = np.pad(np.asarray(sound, np.float64), (0, -len(sound) % _LOUDNESS_BLOCK)).reshape(-1, _LOUDNESS_BLOCK)
    power = np.mean(np.square(blocks), axis=1).max(initial=0)
    if power < 10 ** (SILENCE_DB / 10):
        return np.zeros(0)
    padded = np.pad(np.asarray(audio, np.float32), (0, max(0, _MIN_SAMPLES - len(audio))))
    times = beats.onsets(padded)
    return times[times < duration]


def make_clips(
    rates: Sequence[np.ndarray] | np.ndarray,
    onsets: Sequence[np.ndarray],
    fps: float | np.ndarray,
    *,
    first_frame: int = FIRST_FRAME,
    threshold: float = THRESHOLD,
) -> list[Clip]:
    """Clips whose frames first_frame to T - 1 are scored, with the motion beats of all of them found at once.

    Args:
        rates: (T - 1,) of each clip, from `angle_change_rates`.
        onsets: (k,) seconds from frame 0 of each clip.
        fps: frames per second, of all clips or (n,).
        first_frame, threshold: as for `motion_beats`.
    """
    times, owners, rise = find_stops(rates, fps, first_frame)
    is_beat = rise >= threshold
    parts = np.split(times[is_beat], np.searchsorted(owners[is_beat], np.arange(1, len(rates))))[: len(rates)]
    rows = zip(parts, onsets, rates, np.broadcast_to(fps, len(rates)).tolist(), strict=True)
    return [Clip(beat, onset, first_frame / rate, (len(curve) + 1) / rate) for beat, onset, curve, rate in rows]


def find_stops(
    rates: Sequence[np.ndarray] | np.ndarray, fps: float | np.ndarray, first_frame: int = FIRST_FRAME
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """All minima of the rates (T - 1,) of n clips: their seconds, the clip and the rise of each, all (m,)."""
    scored = [rate[first_frame:] for rate in rates]
    lengths = np.array([len(rate) for rate in scored], int)
    starts = np.cumsum(lengths) - lengths
    is_first = np.zeros(lengths.sum(), bool)
    is_first[starts[lengths > 0]] = True
    found = beats.minima(np.concatenate([np.zeros(0), *scored]), is_first=is_first, equal=True)
    owners = np.repeat(np.arange(len(lengths)), lengths)[found.sample]
    frames = first_frame + found.sample - starts[owners] + found.offset + 0.5
    return frames / np.broadcast_to(fps, len(lengths))[owners], owners, found.rise
