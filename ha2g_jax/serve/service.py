"""What all requests of a service share: the model, the limits, and the threads of the computation."""

import asyncio
import contextlib
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from prometheus_client import Gauge

from ha2g_jax.serve.counters import Counters
from ha2g_jax.serve.settings import Settings
from ha2g_jax.synthesis.model import Model

Result = TypeVar("Result")


class Full(Exception):
    """There is no free place for a request."""


class Places:
    """A number of places, one for each request that runs.

    Args:
        number: number of places.
        gauge: gauge of those that are taken.
    """

    def __init__(self, number: int, gauge: Gauge):
        self._number, self._gauge, self.taken = number, gauge, 0

    @contextlib.contextmanager
    def take(self) -> Iterator[None]:
        """Take a place in this context; without waiting, so that nothing queues up.

        Raises:
            Full: all places are taken.
        """
        if self.taken >= self._number:
            raise Full
        self.taken += 1
        self._gauge.set(self.taken)
        try:
            yield
        finally:
            self.taken -= 1
            self._gauge.set(self.taken)


class Service:
    """A model and the state of the service that generates with it.

    Args:
        model: trained model.
        settings: limits.

    Attributes:
        counters: what the service counts.
        motions: places of requests for motion.
        sessions: places of streams.
        is_stopping: whether new requests are refused, as the process ends.
    """

    def __init__(self, model: Model, settings: Settings):
        self.model, self.settings, self.counters = model, settings, Counters()
        self.motions = Places(settings.requests, self.counters.running)
        self.sessions = Places(settings.sessions, self.counters.sessions)
        self.is_stopping = False
        # As many threads as places: no stream waits for the thread of a long motion.
        self._threads = ThreadPoolExecutor(max(settings.requests + settings.sessions, 1), "ha2g-serve")

    @property
    def is_idle(self) -> bool:
        """Whether nothing is running."""
        return not (self.motions.taken or self.sessions.taken)

    async def compute(self, function: Callable[[], Result]) -> Result:
        """Return the result of a function that runs in a thread.

        Args:
            function: function without arguments.
        """
        return await asyncio.get_running_loop().run_in_executor(self._threads, function)

    def close(self) -> None:
        """Begin no further computation."""
        self._threads.shutdown(wait=False, cancel_futures=True)
