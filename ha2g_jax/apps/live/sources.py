"""Sources of sound: a file, standard input, the microphone, or a WebSocket that others send to."""

import pathlib
from collections.abc import Generator
from typing import NamedTuple, Protocol

import numpy as np
import soxr

from ha2g_jax.apps.live.clock import Clock, Stop, wait_until
from ha2g_jax.features.audio import SAMPLE_RATE, read_audio
from ha2g_jax.files.reading import shown

CHUNK_SECONDS = 0.02


class Chunk(NamedTuple):
    """A piece of sound.

    Attributes:
        samples: (samples,) float32 mono samples at 16 kHz.
        heard: time of the clock, in seconds, at which the first of them is heard.
    """

    samples: np.ndarray
    heard: float


class Source(Protocol):
    """Sound that a live run listens to.

    Attributes:
        name: description for messages and the recording.
        is_timed: whether the sound is heard in real time, so that frames have times to be sent at.
    """

    name: str
    is_timed: bool

    @property
    def lost_seconds(self) -> float:
        """Seconds of sound that came while the computation was too far behind to take it."""
        ...

    def chunks(self, clock: Clock, stop: Stop) -> Generator[Chunk, None, None]:
        """Yield the sound as it is heard, until its end or until the run is to stop."""
        ...


class FileSource:
    """A file with sound, heard in real time or as fast as the computation takes it."""

    lost_seconds = 0.0

    def __init__(self, path: pathlib.Path, is_fast: bool) -> None:
        """Read the file.

        Args:
            path: any file with sound.
            is_fast: whether not to wait until the sound is heard.

        Raises:
            UserError: the file cannot be used, see `features.audio.read_audio`.
        """
        self.name = shown(path.name)
        self._samples, self.is_timed = read_audio(path), not is_fast

    def chunks(self, clock: Clock, stop: Stop) -> Generator[Chunk, None, None]:
        size, start = round(CHUNK_SECONDS * SAMPLE_RATE), clock.now()
        for first in range(0, len(self._samples), size):
            samples = self._samples[first : first + size]
            heard = start + first / SAMPLE_RATE
            if self.is_timed:
                wait_until(heard + len(samples) / SAMPLE_RATE, clock, stop)
            if stop.is_asked():
                return
            yield Chunk(samples, heard)


class Resampler:
    """Conversion of sound that arrives in pieces to 16 kHz."""

    def __init__(self, rate: float) -> None:
        """Start a conversion.

        Args:
            rate: samples per second of the sound.
        """
        self._rate = rate
        self._stream = None if rate == SAMPLE_RATE else soxr.ResampleStream(rate, SAMPLE_RATE, 1, dtype="float32")
        self._taken = self._given = 0

    def resample(self, samples: np.ndarray, heard: float, is_last: bool = False) -> Chunk:
        """Convert a piece.

        Args:
            samples: (samples,) float32 mono; values that are not finite become 0.
            heard: time at which the first of them is heard.
            is_last: whether the sound ends here, so that the rest of it is returned as well.

        Returns:
            The samples that are complete; the resampler holds back the last milliseconds of the piece.
        """
        samples = np.nan_to_num(samples.astype(np.float32, copy=False), nan=0.0, posinf=0.0, neginf=0.0)
        if self._stream is None:
            return Chunk(samples, heard)
        heard += self._given / SAMPLE_RATE - self._taken / self._rate
        resampled = self._stream.resample_chunk(samples, last=is_last)
        self._taken += len(samples)
        self._given += len(resampled)
        return Chunk(resampled, heard)
