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
from collections.abc import Iterator
from types import FrameType

import numpy as np
import uvicorn
from tqdm import tqdm

from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.files.reading import reason
from ha2g_jax.progress import stage
from ha2g_jax.serve.app import create_app
from ha2g_jax.serve.service import Service
from ha2g_jax.serve.settings import Settings, check, resolve
from ha2g_jax.synthesis.model import Model, load

_TICK = 0.05  # seconds between two looks at what is running


def _is_fault(record: logging.LogRecord) -> bool:
    """Return whether a line of the log says more than that a stream was refused with a status, as uvicorn does."""
    return "without completing handshake" not in record.getMessage()


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
        _bound(settings) as bound,
        tempfile.TemporaryDirectory(prefix="ha2g-serve-", ignore_cleanup_errors=True) as folder,
    ):
        with stage("loading and compiling the model"):
            model = load(checkpoint)
            warm_up(model)
        service = Service(model, settings, folder)
        Server(service, announce=True).run(sockets=[bound])
    if service.is_computing:
        # The grace is over; Python would wait for the threads that still compute.
        sys.stderr.flush()
        os._exit(0)


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
        if self._announce and sockets:
            host, port = sockets[0].getsockname()[:2]
            address = f"[{host}]" if ":" in host else host
            tqdm.write(f"ha2g: ready at http://{address}:{port}", file=sys.stderr)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Take no more requests, wait up to the grace for those that run, and end."""
        self.service.is_stopping = True
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


@contextlib.contextmanager
def _bound(settings: Settings) -> Iterator[socket.socket]:
    """Yield a socket with the address of the settings, at which nothing listens before the model is ready."""
    family, address = resolve(settings.host)[0]
    with socket.socket(family, socket.SOCK_STREAM) as bound:
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            bound.bind((address, settings.port))
        except OSError as error:
            raise UserError(
                f"cannot listen at {settings.host}, port {settings.port}: {reason(error).lower()}; give another --port"
            ) from error
        yield bound
