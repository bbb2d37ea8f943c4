"""What all requests of a service share: the model, the limits, and the threads of the computation."""

import asyncio
import contextlib
from collections.abc import Callable, Coroutine, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, TypeVar

from prometheus_client import Gauge

from ha2g_jax.apps.serve.counters import Counters
from ha2g_jax.apps.serve.settings import Settings
from ha2g_jax.synthesis.model import Model

Result = TypeVar("Result")


class Full(Exception):
    """There is no free place for a request."""


class Stopped(Exception):
    """The service has been stopped, and a request did not end in time."""


class Places:
    """A number of places, one for each request that runs.

    Args:
        number: number of places.
        gauge: gauge of those that are taken.

    Attributes:
        taken: number of those that are taken.
        changed: function that is called when that number has changed.
    """

    def __init__(self, number: int, gauge: Gauge):
        self._number, self._gauge, self.taken = number, gauge, 0
        self.changed: Callable[[], None] = lambda: None

    @property
    def are_taken(self) -> bool:
        """Whether no place is free."""
        return self.taken >= self._number

    @contextlib.contextmanager
    def take(self) -> Iterator[None]:
        """Take a place in this context; without waiting, so that nothing queues up.

        Raises:
            Full: all places are taken.
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
    """A model and the state of the service that generates with it.

    Args:
        model: trained model.
        settings: limits.
        folder: folder of temporary files, that of the system by default.

    Attributes:
        counters: what the service counts.
        motions: places of requests for motion.
        sessions: places of streams.
        is_stopping: whether new requests are refused, as the process ends.
    """

    def __init__(self, model: Model, settings: Settings, folder: str | None = None):
        self.folder = folder
        self.model, self.settings, self.counters = model, settings, Counters()
        self.motions = Places(settings.requests, self.counters.running)
        self.sessions = Places(settings.sessions, self.counters.sessions)
        self.is_stopping = False
        # As many threads as places: no stream waits for the thread of a long motion.
        self._stopped = asyncio.Event()
        self._work: set[Future] = set()
        self._threads = ThreadPoolExecutor(max(settings.requests + settings.sessions, 1), "ha2g-serve")

    @property
    def is_idle(self) -> bool:
        """Whether nothing is running."""
        return not (self.motions.taken or self.sessions.taken)

    @property
    def is_computing(self) -> bool:
        """Whether a thread is computing, maybe for a request that has ended."""
        return any(not work.done() for work in tuple(self._work))

    async def run(self, answer: Coroutine[Any, Any, Result]) -> Result:
        """Return the result of a coroutine, which is cancelled when the service is stopped.

        Args:
            answer: what a request or a stream does.

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

    async def compute(self, function: Callable[[], Result]) -> Result:
        """Return the result of a function that runs in a thread.

        Args:
            function: function without arguments.
        """
        work = self._threads.submit(function)
        self._work.add(work)
        work.add_done_callback(self._work.discard)
        return await asyncio.wrap_future(work)

    def close(self) -> None:
        """End all requests and streams that are still running, and begin no further computation."""
        self._stopped.set()
        self._threads.shutdown(wait=False, cancel_futures=True)
