"""The thread that sends frames at their times, and the counts of a live run."""

import contextlib
import queue
import sys
import threading
from collections.abc import Sequence

import numpy as np
from tqdm import tqdm

from ha2g_jax.apps.live.clock import Clock, StopFlag, wait_until
from ha2g_jax.apps.live.frames import Frame
from ha2g_jax.apps.live.sinks import Sink
from ha2g_jax.files.reading import reason

TOO_LATE = 1.0  # seconds after its time at which a frame is dropped
HELD_SECONDS = 10.0  # seconds of frames that wait for their times; with more, the computation waits
_POLL = 0.05  # seconds
_BINS = 10_000  # milliseconds; longer latencies count as the last


class Meter:
    """Counts of a run, in constant memory; one thread computes and another sends.

    Args:
        stated: latency in seconds without the time of the computation.

    Attributes:
        computed: frames that the model computed; those sent, late or dropped have the rate of the sinks.
        late: sent frames that left more than a hop after their time.
        dropped: frames that were not sent, because they were more than a second late or no sink could take them.
        lost_seconds: seconds of sound that were lost, see `Source.lost_seconds`.
    """

    def __init__(self, stated: float) -> None:
        self.computed = self.sent = self.late = self.dropped = 0
        self.compute_seconds = self.sound_seconds = self.lost_seconds = 0.0
        self._stated = stated
        self._latencies = np.zeros(_BINS, np.int64)

    def count_latency(self, seconds: float) -> None:
        """Count the latency of a sent frame: the time from its moment of the sound to its departure."""
        self._latencies[min(max(round(1000 * seconds), 0), _BINS - 1)] += 1

    def latency(self, quantile: float) -> float | None:
        """Return a quantile of the latencies in seconds, to a millisecond; None before the first frame."""
        counts = np.cumsum(self._latencies)
        return None if counts[-1] == 0 else int(np.searchsorted(counts, quantile * counts[-1])) / 1000

    @property
    def real_time_factor(self) -> float:
        """Time of the computation per time of the sound; below 1 it keeps up."""
        return self.compute_seconds / max(self.sound_seconds, 1e-9)

    def line(self) -> str:
        """Return the meter as a line of text."""
        median, most = self.latency(0.5), self.latency(0.95)
        latency = (
            "" if median is None or most is None else f"latency {1000 * median:.0f} ms (95 %: {1000 * most:.0f}), "
        )
        lost = f", {self.lost_seconds:.1f} s of sound lost" if self.lost_seconds else ""
        return (
            f"{self.sound_seconds:.1f} s heard, {self.computed} frames, {latency}{self.late} late, "
            f"{self.dropped} dropped, {self.real_time_factor:.2f} of real time{lost}"
        )

    def summary(self) -> dict[str, float | int | None]:
        """Return the counts by name, in seconds."""
        return {
            "sound_seconds": round(self.sound_seconds, 3),
            "frames": self.computed,
            "sent": self.sent,
            "late": self.late,
            "dropped": self.dropped,
            "lost_seconds": round(self.lost_seconds, 3),
            "latency_stated": round(self._stated, 4),
            "latency_median": self.latency(0.5),
            "latency_95": self.latency(0.95),
            "real_time_factor": round(self.real_time_factor, 4),
        }


class Sender:
    """Sends frames in order, each at its time or, if it is computed later, at once.

    Frame k is due `delay` seconds after its moment is heard. A frame that is more than `TOO_LATE` after that is
    dropped. The frames that wait are bounded: `put` waits while there are too many.

    Args:
        sinks: receivers of every frame.
        fps: frames per second.
        delay: seconds from the moment that is heard to its frame; None to send frames as they are computed.
        allowed: seconds after its time from which a frame counts as late.
        clock: clock of the times.
        meter: counts the frames.
    """

    def __init__(
        self, sinks: Sequence[Sink], fps: float, delay: float | None, allowed: float, clock: Clock, meter: Meter
    ) -> None:
        self._sinks, self._delay, self._allowed = tuple(sinks), delay, allowed
        self._clock, self._meter, self._stop = clock, meter, StopFlag()
        self._frames: queue.Queue[Frame | None] = queue.Queue(max(1, round(HELD_SECONDS * fps)))
        self._reported: set[tuple[Sink, str]] = set()
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def put(self, frame: Frame | None, stop: StopFlag) -> None:
        """Append a frame, or None for the end, and wait while too many frames wait; drop it if the run is to stop."""
        while not stop.is_asked() and self._error is None:
            with contextlib.suppress(queue.Full):
                self._frames.put(frame, timeout=_POLL)
                return
        if self._error is not None:
            raise self._error

    def finish(self, stop: StopFlag) -> None:
        """Wait until all frames are sent, or leave out those that wait if the run is to stop."""
        self.put(None, stop)
        while self._thread.is_alive() and not stop.is_asked():
            self._thread.join(_POLL)
        self.close()
        if self._error is not None:
            raise self._error

    def close(self) -> None:
        """End the thread; frames that wait are not sent."""
        self._stop.ask()
        self._thread.join()

    def _run(self) -> None:
        try:
            while not self._stop.is_asked():
                with contextlib.suppress(queue.Empty):
                    frame = self._frames.get(timeout=_POLL)
                    if frame is None:
                        return
                    self._send_in_time(frame)
        except BaseException as error:  # raised again where the run waits for this thread
            self._error = error

    def _send_in_time(self, frame: Frame) -> None:
        if self._delay is None:
            self._send(frame)
            return
        due = frame.heard + self._delay
        if not wait_until(due, self._clock, self._stop):
            return
        now = self._clock.now()
        if now - due > TOO_LATE:
            self._meter.dropped += 1
        elif self._send(frame):
            self._meter.late += now - due > self._allowed
            self._meter.count_latency(now - frame.heard)

    def _send(self, frame: Frame) -> bool:
        """Send a frame to all sinks, and return whether one of them took it."""
        is_sent = False
        for sink in self._sinks:
            try:
                sink.send(frame)
                is_sent = True
            except OSError as error:  # such as a network that is down for a while; reported once
                if (problem := (sink, reason(error))) not in self._reported:
                    self._reported.add(problem)
                    tqdm.write(f"{sink.name} misses frames: {problem[1].lower()}", file=sys.stderr)
        self._meter.sent += is_sent
        self._meter.dropped += not is_sent
        return is_sent
