"""Loudness of a recording: a clock that runs only during speech, and cuts at quiet moments."""

from typing import NamedTuple

import numpy as np

from ha2g_jax.features.audio import SAMPLE_RATE

FRAME_SECONDS = 0.01
_FRAME = round(FRAME_SECONDS * SAMPLE_RATE)
# Speech lies within this many decibels of the loudest hundredth.
_SPEECH_DB = 35.0
# The clock moves slowly in silence, so that it is invertible.
_SILENCE_SPEED = 0.02


class VoicedClock(NamedTuple):
    """A clock that almost stops in silence.

    Attributes:
        times: (frames + 1,) times in the recording, in seconds.
        readings: (frames + 1,) duration of speech up to each time, in seconds, strictly increasing.
    """

    times: np.ndarray
    readings: np.ndarray

    def to_voiced(self, time: float) -> float:
        """Convert a time in the recording to a reading of the clock."""
        return float(np.interp(time, self.times, self.readings))

    def to_time(self, reading: float) -> float:
        """Convert a reading of the clock to a time in the recording."""
        return float(np.interp(reading, self.readings, self.times))


def loudness(audio: np.ndarray) -> np.ndarray:
    """Compute the level of each 10 ms in decibels, smoothed over 50 ms.

    Args:
        audio: (samples,) float32 at 16 kHz.

    Returns:
        (frames,) float64 with frames = samples // 160, at least 1.
    """
    frames = max(1, len(audio) // _FRAME)
    padded = np.zeros(frames * _FRAME)
    padded[: len(audio)] = audio[: frames * _FRAME]
    power = np.square(padded.reshape(frames, _FRAME)).mean(axis=1)
    smooth = np.convolve(np.pad(power, 2, mode="edge"), np.full(5, 0.2), mode="valid")
    return 10 * np.log10(smooth + 1e-10)


def voiced_clock(audio: np.ndarray) -> VoicedClock:
    """Compute the speech clock of a recording.

    Args:
        audio: (samples,) float32 at 16 kHz.
    """
    level = loudness(audio)
    speed = np.where(level > np.quantile(level, 0.99) - _SPEECH_DB, 1.0, _SILENCE_SPEED)
    readings = np.concatenate([[0.0], np.cumsum(speed) * FRAME_SECONDS])
    return VoicedClock(np.arange(len(readings)) * FRAME_SECONDS, readings)


def cut_at_quiet(audio: np.ndarray, max_seconds: float) -> list[tuple[float, float]]:
    """Cut a recording into pieces, each of which ends at the quietest moment of its second half.

    Args:
        audio: (samples,) float32 at 16 kHz.
        max_seconds: maximum length of a piece in seconds.

    Returns:
        (start, end) of each piece in seconds; together they cover the whole recording.
    """
    level = loudness(audio)
    longest = round(max_seconds / FRAME_SECONDS)
    duration, start, pieces = len(audio) / SAMPLE_RATE, 0, []
    while duration - start * FRAME_SECONDS > max_seconds:
        middle = start + longest // 2
        end = middle + int(np.argmin(level[middle : start + longest]))
        pieces.append((start * FRAME_SECONDS, end * FRAME_SECONDS))
        start = end
    return [*pieces, (start * FRAME_SECONDS, duration)]
