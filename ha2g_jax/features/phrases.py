"""Detection of voice and of the ends of phrases, at which a listener nods, in sound that arrives in pieces.

A column of the spectrogram is voice if its level between 150 and 4000 Hz is above the floor, the least level of the
last seconds, and not far below the peaks of the voice so far. A phrase is voice without a pause; its end is known only
after the pause. Neither the level of the voice nor that of steady noise matters. Noise that swells, and music with the
rhythm of speech, may be taken for voice.
"""

import math

import numpy as np

from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.features.spectrum import FFT_SIZE, HOP_LENGTH, NUM_MELS, mel_frequencies, mel_power

PAUSE = 0.3  # seconds without voice that end a phrase
LEAST_PHRASE = 1.0  # seconds of the shortest phrase whose end counts
_LEAST_VOICE = 0.2  # seconds; shorter voice is a click
_PAUSE_COLUMNS = 11  # columns of `PAUSE`, and of the end of a word that is too quiet to be voice
_VOICE_HZ = 150, 4000
_LEAST_DB, _FIRST_PEAK_DB = -68.0, -20.0  # levels of a column; the first is that of digital silence
_ABOVE_FLOOR_DB, _BELOW_PEAK_DB = 6.0, 24.0  # distances of the quietest voice from the floor and from the peak
_DROP_DB = 8.0  # drop from the mean level of a phrase to that of a pause
_FLOOR_COLUMNS = 94  # three seconds
_FALL_DB = 1.0  # decay of the peak per second of voice
_COLUMN = HOP_LENGTH / SAMPLE_RATE  # seconds
_BANDS = slice(*np.searchsorted(mel_frequencies(NUM_MELS + 2)[1:-1], _VOICE_HZ).tolist())


class Phrases:
    """Detector of voice and of the ends of phrases in sound that arrives in pieces, in constant memory.

    Args:
        seconds: time for which voice and ends are remembered.
        num_samples: samples of silence before the first; the result is the same as if they had been added.

    Attributes:
        ends: times in seconds of the ends of phrases of at least `LEAST_PHRASE`, which a pause of `PAUSE` has followed.
    """

    def __init__(self, seconds: float, num_samples: int = 0):
        self.ends: list[float] = []
        self._seconds = seconds
        self._num_columns = num_samples // HOP_LENGTH
        self._samples = np.zeros(num_samples % HOP_LENGTH + HOP_LENGTH, np.float32)  # from half a column before
        self._is_voice = np.zeros(math.ceil(seconds / _COLUMN), bool)  # the latest column last
        self._levels = np.full(_FLOOR_COLUMNS, _LEAST_DB)
        self._peak = _FIRST_PEAK_DB
        self._first = self._last = 0  # numbers of the columns of the phrase with voice
        self._num_voice = 0  # of these columns
        self._voice_sum = self._pause_sum = 0.0  # of the levels of the voice, and since the last of it

    def add(self, samples: np.ndarray) -> None:
        """Add samples (samples,) float32 at 16 kHz to the end."""
        self._samples = np.concatenate([self._samples, samples])
        start = 0
        while start + FFT_SIZE <= len(self._samples):
            self._add_column(self._samples[start : start + FFT_SIZE])
            start += HOP_LENGTH
        self._samples = self._samples[start:].copy()

    def has_voice(self, start: float, end: float) -> bool:
        """Return whether there is voice, longer than a click, between two remembered times in seconds."""
        first = len(self._is_voice) - self._num_columns
        columns = (max(first + round(time / _COLUMN), 0) for time in (start, end))
        return bool(self._is_voice[slice(*columns)].sum() * _COLUMN >= _LEAST_VOICE)

    def _add_column(self, samples: np.ndarray) -> None:
        """Add the column that is centred at its number times `_COLUMN` seconds."""
        power = float(mel_power(samples)[_BANDS, 0].mean())
        level = max(10 * math.log10(max(power, 1e-9)), _LEAST_DB)
        is_voice = level > max(float(self._levels.min()) + _ABOVE_FLOOR_DB, self._peak - _BELOW_PEAK_DB)
        for kept, latest in ((self._levels, level), (self._is_voice, is_voice)):
            kept[:-1] = kept[1:]
            kept[-1] = latest
        if is_voice:
            self._peak = max(level, self._peak - _FALL_DB * _COLUMN)
            self._first = self._first if self._num_voice else self._num_columns
            self._last, self._num_voice = self._num_columns, self._num_voice + 1
            self._voice_sum, self._pause_sum = self._voice_sum + level, 0.0
        elif self._num_voice:
            self._pause_sum += level
            if self._num_columns - self._last == _PAUSE_COLUMNS:
                self._end_phrase()
        self._num_columns += 1
        earliest = self._num_columns * _COLUMN - self._seconds
        self.ends = [end for end in self.ends if end > earliest]

    def _end_phrase(self) -> None:
        drop = self._voice_sum / self._num_voice - self._pause_sum / _PAUSE_COLUMNS
        if (self._last + 1 - self._first) * _COLUMN >= LEAST_PHRASE and drop > _DROP_DB:
            self.ends.append((self._last + 0.5) * _COLUMN)
        self._num_voice, self._voice_sum, self._pause_sum = 0, 0.0, 0.0
