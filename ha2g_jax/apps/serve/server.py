"""The process: it listens when the model is compiled, and ends when its requests are done."""

import asyncio
import contextlib
import logging
import os
import pathlib
import signal
import socket
import sys
import tempfile
import time
from types import FrameType

import numpy as np
import uvicorn
from tqdm import tqdm

from ha2g_jax.apps.serve.address import bound, url
from ha2g_jax.apps.serve.app import create_app
from ha2g_jax.apps.serve.service import Service
from ha2g_jax.apps.serve.settings import Settings, check
from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.progress import stage
from ha2g_jax.synthesis.model import Model, load

_TICK = 0.05  # seconds between two looks at what is running


def _is_fault(record: logging.LogRecord) -> bool:
    """Return whether a line of the log is about a fault, and not about a stream that was refused or a client's text."""
    return not any(text in record.getMessage() for text in ("without completing handshake", "Invalid UTF-8 sequence"))


def run(checkpoint: str | pathlib.Path, settings: Settings) -> None:
    """Load and compile a model, then answer requests until SIGTERM or Ctrl-C.

    Args:
        checkpoint: model, see `synthesis.load`.
        settings: address, token and limits.

    Raises:
        UserError: the settings or the model cannot be used, or the address is taken.
        KeyboardInterrupt: Ctrl-C, after the running requests.
    """
    check(settings)
    with (
        bound(settings.host, settings.port) as listener,
        tempfile.TemporaryDirectory(prefix="ha2g-serve-", ignore_cleanup_errors=True) as folder,
    ):
        with stage("loading and compiling the model"):
            model = load(checkpoint)
            warm_up(model)
        service, was_interrupted = Service(model, settings, folder), False
        try:
            Server(service, announce=True).run(sockets=[listener])
        except KeyboardInterrupt:  # uvicorn raises it when it has stopped
            was_interrupted = True
    leave(service, 128 + signal.SIGINT if was_interrupted else 0)
    if was_interrupted:
        raise KeyboardInterrupt


def leave(service: Service, code: int = 0) -> None:
    """End the process if a thread still computes after the grace, as Python would wait for it.

    Args:
        service: service that was stopped.
        code: exit code.
    """
    if service.is_computing:
        sys.stderr.flush()
        os._exit(code)


def warm_up(model: Model) -> None:
    """Compile what the first requests would wait for.

    Args:
        model: model to compile.
    """
    model.generate(np.zeros(SAMPLE_RATE, np.float32))
    with contextlib.suppress(UserError):  # a model that reads words has no streams
        model.stream()


class Server(uvicorn.Server):
    """Server of one service, which waits for running requests and streams when it is stopped.

    Args:
        service: service to run.
        announce: whether to print the address when requests are taken.

    Attributes:
        service: the same service.
    """

    def __init__(self, service: Service, *, announce: bool = False):
        settings = service.settings
        config = uvicorn.Config(
            create_app(service),
            lifespan="off",
            log_config=None,
            log_level="warning",
            access_log=False,
            proxy_headers=False,
            server_header=False,
            ws="websockets-sansio",
            ws_max_size=settings.message_bytes,
            ws_per_message_deflate=False,
            timeout_graceful_shutdown=1,
        )
        super().__init__(config)
        logging.getLogger("uvicorn.error").addFilter(_is_fault)
        self.service, self._announce = service, announce

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Begin to take requests."""
        await super().startup(sockets)
        self.service.counters.workers.set(1)
        if self._announce and sockets:
            tqdm.write(f"ha2g: ready at {url(sockets[0])}", file=sys.stderr)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Take no more requests, wait up to the grace for those that run, and end."""
        self.service.is_stopping = True
        self.service.counters.workers.set(0)
        for server in self.servers:
            server.close()
        end = time.monotonic() + self.service.settings.grace
        while not self.service.is_idle and time.monotonic() < end and not self.force_exit:
            await asyncio.sleep(_TICK)
        self.service.close()
        await asyncio.sleep(_TICK)  # for what is still running to be answered
        await super().shutdown(sockets)

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """Stop; after SIGTERM the process ends with code 0, a second signal ends it at once."""
        if self.should_exit:
            self.force_exit = True
        if sig == signal.SIGINT:
            super().handle_exit(sig, frame)
        self.should_exit = True
