"""What all requests of a service share: the model, the limits, the counters, and the threads that compute."""

import asyncio
import contextlib
import os
import pathlib
from collections.abc import Callable, Coroutine, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TYPE_CHECKING, Any, TypeVar

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, generate_latest
from prometheus_client.multiprocess import MultiProcessCollector

from ha2g_jax.apps.serve.settings import Settings

if TYPE_CHECKING:  # the process that shares connections among workers loads no JAX
    from ha2g_jax.synthesis.model import Model

Result = TypeVar("Result")

FOLDER = "PROMETHEUS_MULTIPROC_DIR"  # variable of prometheus_client: folder in which workers share their values

_MOTION_SECONDS = (0.1, 0.25, 0.5, 1, 2.5, 5, 10, 30, 60)
_FEED_SECONDS = (0.002, 0.005, 0.01, 0.02, 0.04, 0.0667, 0.1, 0.2, 0.5, 1)


class Counters:
    """Counters of one service in the form of Prometheus; where there are several workers, the sums over them.

    A stream that begins counts as a request with status 101; errors are labelled with the close code of the stream.
    """

    def __init__(self) -> None:
        self._registry = registry = CollectorRegistry()
        labels = ("route", "status")
        self.requests = Counter("ha2g_requests", "Requests answered", labels, registry=registry)
        self.motion_seconds = self._times("ha2g_motion_seconds", "Time to generate a motion", _MOTION_SECONDS)
        self.feed_seconds = self._times(
            "ha2g_feed_seconds", "Computation for a piece of sound of a stream", _FEED_SECONDS
        )
        self.frames = Counter("ha2g_frames", "Frames sent in streams", registry=registry)
        self.errors = Counter("ha2g_stream_errors", "Streams ended with an error", ("code",), registry=registry)
        self.running = self._gauge("ha2g_requests_running", "Requests for motion that are running")
        self.sessions = self._gauge("ha2g_sessions", "Streams that are running")
        self.workers = self._gauge("ha2g_workers", "Processes that take requests")

    def _times(self, name: str, text: str, buckets: tuple[float, ...]) -> Histogram:
        return Histogram(name, text, buckets=buckets, registry=self._registry)

    def _gauge(self, name: str, text: str) -> Gauge:
        """Return a gauge that is summed over the processes that run."""
        return Gauge(name, text, registry=self._registry, multiprocess_mode="livesum")

    def text(self) -> bytes:
        """Return all values in the text form of Prometheus."""
        if FOLDER not in os.environ:
            return generate_latest(self._registry)
        registry = CollectorRegistry()
        pathlib.Path(os.environ[FOLDER]).stat()  # raises an OSError where the folder is gone
        MultiProcessCollector(registry)
        return generate_latest(registry)


class Full(Exception):
    """No slot is free for a request."""


class Stopped(Exception):
    """The service has been stopped, and a request did not end in time."""


class Slots:
    """A number of slots, one for each running request.

    Attributes:
        taken: number of slots that are taken.
        changed: function that is called when that number has changed.
    """

    def __init__(self, number: int, gauge: Gauge):
        self._number, self._gauge, self.taken = number, gauge, 0
        self.changed: Callable[[], None] = lambda: None

    @property
    def are_taken(self) -> bool:
        return self.taken >= self._number

    @contextlib.contextmanager
    def take(self) -> Iterator[None]:
        """Take a slot in this context, without waiting, so that nothing queues up.

        Raises:
            Full: all slots are taken.
        """
        if self.are_taken:
            raise Full
        self._set(self.taken + 1)
        try:
            yield
        finally:
            self._set(self.taken - 1)

    def _set(self, taken: int) -> None:
        self.taken = taken
        self._gauge.set(taken)
        self.changed()


class Service:
    """A model and the state of the service that generates with it: slots for requests for motion, and for streams.

    Attributes:
        folder: folder of temporary files, that of the system by default.
        is_stopping: whether new requests are refused, as the process ends.
    """

    def __init__(self, model: "Model", settings: Settings, folder: str | None = None):
        self.folder = folder
        self.model, self.settings, self.counters = model, settings, Counters()
        self.motions = Slots(settings.requests, self.counters.running)
        self.sessions = Slots(settings.sessions, self.counters.sessions)
        self.is_stopping = False
        self._stopped = asyncio.Event()
        self._work: set[Future] = set()
        # As many threads as slots, so that no stream waits for the thread of a long motion.
        self._threads = ThreadPoolExecutor(max(settings.requests + settings.sessions, 1), "ha2g-serve")

    @property
    def is_idle(self) -> bool:
        return not (self.motions.taken or self.sessions.taken)

    @property
    def is_computing(self) -> bool:
        """Whether a thread is computing, perhaps for a request that has ended."""
        return any(not work.done() for work in tuple(self._work))

    async def run(self, answer: Coroutine[Any, Any, Result]) -> Result:
        """Return the result of the work of a request or a stream, which is cancelled when the service is stopped.

        Raises:
            Stopped: the service was stopped first.
        """
        task, stopped = asyncio.ensure_future(answer), asyncio.ensure_future(self._stopped.wait())
        try:
            await asyncio.wait({task, stopped}, return_when=asyncio.FIRST_COMPLETED)
            if not task.done():
                raise Stopped
            return task.result()
        finally:
            stopped.cancel()
            task.cancel()

    async def compute(self, function: Callable[..., Result], *arguments: Any) -> Result:
        """Return the result of a function that runs in a thread."""
        work = self._threads.submit(function, *arguments)
        self._work.add(work)
        work.add_done_callback(self._work.discard)
        return await asyncio.wrap_future(work)

    def close(self) -> None:
        """End all requests and streams that are still running, and begin no further computation."""
        self._stopped.set()
        self._threads.shutdown(wait=False, cancel_futures=True)
