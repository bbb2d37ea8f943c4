"""Onsets of the sound that motion beats are compared with."""

import math

import numpy as np

from ha2g_jax.features.librosa_once import librosa

ONSET_RATE = 16000  # samples per second of the sound that onsets are found in
SILENCE_DB = -60.0  # re full scale: a clip in which no 64 ms are louder has no onsets

_LOUDNESS_BLOCK = 1024  # samples
_MIN_SAMPLES = 2048  # that the spectrogram of the onset detector needs


def detect_onsets(audio: np.ndarray) -> np.ndarray:
    """Return the times (n,), in seconds, of the onsets of samples at 16 kHz, by librosa's detector with defaults."""
    return librosa("onset").onset_detect(y=audio, sr=ONSET_RATE, units="time")


def audio_onsets(audio: np.ndarray, duration: float) -> np.ndarray:
    """Return the times in seconds, (n,), of the onsets of a clip's sound, without those of silence.

    There are none where the sound stays under -60 dB: the root mean square of 64 ms, re full scale. This is much slower
    than all scores together and depends on the sound alone: find the onsets once per clip and keep them.

    Args:
        audio: (samples,) at 16 kHz.
        duration: length of the motion in seconds; later sound is left out.
    """
    sound = audio[: math.ceil(duration * ONSET_RATE)]
    blocks = np.pad(np.asarray(sound, np.float64), (0, -len(sound) % _LOUDNESS_BLOCK)).reshape(-1, _LOUDNESS_BLOCK)
    power = np.mean(np.square(blocks), axis=1).max(initial=0)
    if power < 10 ** (SILENCE_DB / 10):
        return np.zeros(0)
    padded = np.pad(np.asarray(audio, np.float32), (0, max(0, _MIN_SAMPLES - len(audio))))
    times = detect_onsets(padded)
    return times[times < duration]
