"""The thread that sends frames at their times."""

import contextlib
import queue
import sys
import threading
from collections.abc import Sequence

from tqdm import tqdm

from ha2g_jax.apps.live.clock import Clock, Stop, wait_until
from ha2g_jax.apps.live.frames import Frame
from ha2g_jax.apps.live.meter import Meter
from ha2g_jax.apps.live.sinks import Sink
from ha2g_jax.files.reading import reason

TOO_LATE = 1.0  # seconds after its time at which a frame is dropped
HELD_SECONDS = 10.0  # of frames that wait for their times; the computation waits beyond
_POLL = 0.05  # seconds


class Sender:
    """Sends frames in order, each at its time or, if it is computed later, at once.

    Frame k is due `delay` seconds after its moment is heard. A frame that is more than `TOO_LATE` after that is
    dropped. The frames that wait are bounded: `put` waits while there are too many.
    """

    def __init__(
        self, sinks: Sequence[Sink], fps: float, delay: float | None, allowed: float, clock: Clock, meter: Meter
    ) -> None:
        """Start the thread.

        Args:
            sinks: take every frame.
            fps: frames per second.
            delay: seconds from the moment that is heard to its frame; None to send frames as they are computed.
            allowed: seconds after its time from which a frame counts as late.
            clock: clock of the times.
            meter: takes the counts.
        """
        self._sinks, self._delay, self._allowed = tuple(sinks), delay, allowed
        self._clock, self._meter, self._stop = clock, meter, Stop()
        self._frames: queue.Queue[Frame | None] = queue.Queue(max(1, round(HELD_SECONDS * fps)))
        self._faults: set[tuple[Sink, str]] = set()
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def put(self, frame: Frame | None, stop: Stop) -> None:
        """Append a frame, or None for the end, and wait while too many frames wait.

        Args:
            frame: frame to send.
            stop: request that ends the wait; the frame is not sent then.
        """
        while not stop.is_asked() and self._error is None:
            with contextlib.suppress(queue.Full):
                self._frames.put(frame, timeout=_POLL)
                return
        if self._error is not None:
            raise self._error

    def finish(self, stop: Stop) -> None:
        """Wait until all frames are sent, or leave out those that wait if the run is to stop.

        Args:
            stop: request that ends the wait.
        """
        self.put(None, stop)
        while self._thread.is_alive() and not stop.is_asked():
            self._thread.join(_POLL)
        self._stop.ask()
        self._thread.join()
        if self._error is not None:
            raise self._error

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
            return
        self._meter.late += now - due > self._allowed
        self._send(frame)
        self._meter.count_latency(now - frame.heard)

    def _send(self, frame: Frame) -> None:
        for sink in self._sinks:
            try:
                sink.send(frame)
            except OSError as error:  # such as a network that is down for a while; reported once
                if (fault := (sink, reason(error))) not in self._faults:
                    self._faults.add(fault)
                    tqdm.write(f"{sink.name} misses frames: {fault[1].lower()}", file=sys.stderr)
        self._meter.sent += 1
