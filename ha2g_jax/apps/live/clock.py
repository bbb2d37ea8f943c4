"""Time of a live run: the clock of the computer, requests to stop, and the times at which sound is heard."""

import collections
import time

from ha2g_jax.features.audio import SAMPLE_RATE

_LONGEST_SLEEP = 0.05  # seconds until a request to stop is noticed


class Clock:
    """The monotonic clock of the computer, in seconds."""

    def now(self) -> float:
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        time.sleep(seconds)


class StopFlag:
    """Request to end a run; a flag that a signal handler may set at any moment.

    Attributes:
        signal: number of the signal that requested it, 0 without one.
    """

    def __init__(self) -> None:
        self.signal = 0
        self._is_asked = False

    def ask(self, number: int = 0) -> None:
        self.signal, self._is_asked = self.signal or number, True

    def is_asked(self) -> bool:
        return self._is_asked


def wait_until(moment: float, clock: Clock, stop: StopFlag) -> bool:
    """Wait until a time of the clock; return False if the run is to stop before."""
    while not stop.is_asked():
        if (left := moment - clock.now()) <= 0:
            return True
        clock.sleep(min(left, _LONGEST_SLEEP))
    return False


class Timeline:
    """The times at which the samples of a run are heard; it remembers only the last `seconds` of sound."""

    def __init__(self, seconds: float) -> None:
        self._pieces: collections.deque[tuple[int, float]] = collections.deque()
        self._remembered = round(seconds * SAMPLE_RATE)
        self.num_samples = 0

    def add(self, num_samples: int, heard: float) -> None:
        """Append samples at 16 kHz, the first of which is heard at a time of the clock."""
        self._pieces.append((self.num_samples, heard))
        self.num_samples += num_samples
        while len(self._pieces) > 1 and self._pieces[1][0] < self.num_samples - self._remembered:
            self._pieces.popleft()

    def heard(self, seconds: float) -> float:
        """Return the time of the clock at which a moment of the sound is heard.

        Args:
            seconds: time since the first sample, without the pauses of the source.
        """
        sample = seconds * SAMPLE_RATE
        start, heard = next((piece for piece in reversed(self._pieces) if piece[0] <= sample), self._pieces[0])
        return heard + (sample - start) / SAMPLE_RATE
