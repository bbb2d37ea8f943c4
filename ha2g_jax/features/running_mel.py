"""The log-mel spectrogram of speech that arrives in pieces, in memory that does not grow.

Its columns are those of `features.spectrum.log_mel`. Only 0 dB differs: the maximum of a clip is not known before its
end, so that 0 dB is a running level, which each window takes as it is at its time.
"""

import numpy as np

from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.features.spectrum import FFT_SIZE, HOP_LENGTH, NUM_MELS, decibels, mel_power

# The loudest mel power of speech with a peak of about 0.2: 12 to 37 in four recordings. 0 dB starts here, so that the
# noise before the first word is not taken for speech, and louder speech raises it at once.
TYPICAL_POWER = 15.0
# 0 dB falls slowly while there is sound, so that one loud moment is forgotten after some minutes and a quiet voice is
# heard; it does not fall in pauses, and not below the level of a peak of about 0.02.
_FALL_DB = 0.2  # per second of sound
_SOUND_DB = 30.0  # a column whose loudest band is within this of 0 dB is sound
_LEAST_POWER = TYPICAL_POWER / 100

_FALL = 10 ** (-_FALL_DB / 10 * HOP_LENGTH / SAMPLE_RATE)
_SOUND = 10 ** (-_SOUND_DB / 10)


class RunningMel:
    """The last columns of the spectrogram of speech that goes on.

    Args:
        num_columns: number of columns that are kept.
        reference: mel power of 0 dB; by default a running level that starts at `TYPICAL_POWER`.
    """

    def __init__(self, num_columns: int, reference: float | None = None):
        self._reference = TYPICAL_POWER if reference is None else reference
        self._is_running = reference is None
        self._powers = np.zeros((num_columns, NUM_MELS), np.float32)  # the latest column last; silence before the first
        self._num_columns = 0  # that were computed since the start
        self._samples = np.zeros(0, np.float32)  # those that later columns need, from number `_first` on
        self._first = 0

    def add(self, samples: np.ndarray) -> None:
        """Add samples (samples,) float32 at 16 kHz to the end, and compute the columns that they complete."""
        self._samples = np.concatenate([self._samples, samples])
        while HOP_LENGTH * (self._num_columns + 1) <= self._first + len(self._samples):
            if self._num_columns == 0:  # the start is reflected; the weight of the first sample of a column is 0
                half = self._samples[:HOP_LENGTH]
                self._add_column(np.concatenate([half[:1], half[:0:-1], half]))
            else:
                start = HOP_LENGTH * (self._num_columns - 1) - self._first
                self._add_column(self._samples[start : start + FFT_SIZE])
        # The last column reflects the end of the speech, for which it needs one sample more.
        done = max(HOP_LENGTH * (self._num_columns - 1) - 1 - self._first, 0)
        self._samples, self._first = self._samples[done:].copy(), self._first + done

    def end(self) -> None:
        """Compute the last column, in which the end of the speech is reflected; silence follows."""
        if not self._first + len(self._samples):
            return
        half = FFT_SIZE // 2
        padded = np.pad(self._samples, (0 if self._first else half, half), mode="reflect")
        start = HOP_LENGTH * self._num_columns - (self._first + half if self._first else 0)
        self._add_column(padded[start : start + FFT_SIZE])

    def window(self, start: int, columns: int) -> np.ndarray:
        """Return columns of the spectrogram, (128, columns) float32 dB, at the precision of `data.speech`.

        Columns before the start of the speech, and those that are not computed, are silence.
        """
        end = start + columns
        known = min(max(end, start), self._num_columns)
        first = len(self._powers) - self._num_columns + start
        powers = np.zeros((columns, NUM_MELS), np.float32)
        powers[: max(known - start, 0)] = self._powers[first : first + max(known - start, 0)]
        return decibels(powers.T, self._reference).astype(np.float16).astype(np.float32)

    def _add_column(self, samples: np.ndarray) -> None:
        power = mel_power(samples)[:, 0]
        self._powers[:-1] = self._powers[1:]
        self._powers[-1] = power
        self._num_columns += 1
        loudest = float(power.max())
        if self._is_running and loudest > self._reference * _SOUND:
            self._reference = max(loudest, self._reference * _FALL, _LEAST_POWER)
