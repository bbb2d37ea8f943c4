"""Voice and the ends of phrases in sound that arrives in pieces: what someone who listens nods at.

A phrase is voice without a pause of `PAUSE` seconds. Its end is known that long after it, and no sample later. Whether
a column of the spectrogram is voice follows from its level between 150 and 4000 Hz: it is above the floor, which is the
least level of the last seconds, and not far below the peaks of the voice so far. Steady noise and the level of the
voice therefore do not matter; music whose level rises and falls as that of speech does is taken for voice.
"""

import numpy as np

from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.features.spectrum import (
    FFT_SIZE,
    HOP_LENGTH,
    LEAST_POWER,
    NUM_MELS,
    TYPICAL_POWER,
    mel_frequencies,
    mel_power,
)

PAUSE = 0.3  # seconds without voice that end a phrase
LEAST_PHRASE = 1.0  # seconds of the shortest phrase whose end counts
KEPT = 4.0  # seconds of sound that are remembered
_VOICE_HZ = 150, 4000
_ABOVE_FLOOR_DB, _BELOW_PEAK_DB = 9.0, 27.0
_FALL_DB = 1.0  # of the peak per second of voice
_COLUMN = HOP_LENGTH / SAMPLE_RATE  # seconds
_BANDS = slice(*np.searchsorted(mel_frequencies(NUM_MELS + 2)[1:-1], _VOICE_HZ).tolist())


class Phrases:
    """Voice and the ends of phrases of sound that arrives in pieces, in memory that does not grow.

    Attributes:
        ends: times in seconds of the ends of phrases of at least `LEAST_PHRASE` in the last `KEPT` seconds, which a
            pause of `PAUSE` has followed.
    """

    def __init__(self, num_samples: int = 0):
        """Begin after samples of silence, whose result is the same as that of adding them."""
        self.ends: list[float] = []
        self._num_columns = num_samples // HOP_LENGTH
        self._samples = np.zeros(num_samples % HOP_LENGTH + HOP_LENGTH, np.float32)  # from half a column before on
        count = round(KEPT / _COLUMN)
        self._is_voice = np.zeros(count, bool)  # the latest column last
        self._levels = np.full(count, _decibels(0.0))
        self._peak = _decibels(TYPICAL_POWER)
        self._phrase: list[int] = []  # its first and its last column with voice

    def add(self, samples: np.ndarray) -> None:
        """Add samples (samples,) float32 at 16 kHz to the end."""
        self._samples = np.concatenate([self._samples, samples])
        start = 0
        while start + FFT_SIZE <= len(self._samples):
            self._add_column(self._samples[start : start + FFT_SIZE])
            start += HOP_LENGTH
        self._samples = self._samples[start:].copy()

    def has_voice(self, start: float, end: float) -> bool:
        """Return whether there is voice between two times in seconds, of which the last `KEPT` seconds are known."""
        first = len(self._is_voice) - self._num_columns
        columns = (max(first + round(time / _COLUMN), 0) for time in (start, end))
        return bool(self._is_voice[slice(*columns)].any())

    def _add_column(self, samples: np.ndarray) -> None:
        """Add the column that is centred at its number times `_COLUMN` seconds."""
        level = _decibels(float(mel_power(samples)[_BANDS, 0].mean()))
        least = max(self._levels.min() + _ABOVE_FLOOR_DB, self._peak - _BELOW_PEAK_DB)
        is_voice = level > least
        for kept, latest in ((self._levels, level), (self._is_voice, is_voice)):
            kept[:-1] = kept[1:]
            kept[-1] = latest
        if is_voice:
            self._peak = max(level, self._peak - _FALL_DB * _COLUMN)
            self._phrase = [*self._phrase[:1], *([self._num_columns] * (1 if self._phrase else 2))]
        elif self._phrase and (self._num_columns - self._phrase[1]) * _COLUMN >= PAUSE:
            start, end = ((column + half) * _COLUMN for column, half in zip(self._phrase, (-0.5, 0.5), strict=True))
            if end - start >= LEAST_PHRASE:
                self.ends.append(end)
            self._phrase = []
        self._num_columns += 1
        now = self._num_columns * _COLUMN
        self.ends = [end for end in self.ends if now - end < KEPT]


def _decibels(power: float) -> float:
    return float(10 * np.log10(max(power, LEAST_POWER / 1000)))
