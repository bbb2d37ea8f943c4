"""A process of the service: it listens when the model is compiled, and ends when its requests are done.

The module is also the program of a worker, which takes the connections that its parent gives it, see `workers`. Its
standard input is JSON: the model, the settings, and a folder for temporary files. On the socket whose number is its
argument it receives connections, and sends a `Report` as a line of JSON when something has changed.
"""

import asyncio
import contextlib
import gc
import json
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
from threadpoolctl import threadpool_limits
from tqdm import tqdm

from ha2g_jax.apps.serve.app import create_app
from ha2g_jax.apps.serve.service import Service
from ha2g_jax.apps.serve.settings import Settings, bound, url
from ha2g_jax.apps.serve.workers import Report, on_hangup
from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.files.reading import reason
from ha2g_jax.progress import stage
from ha2g_jax.synthesis.model import Model, load

_TICK = 0.05  # seconds between two looks at what is running
_REPORT_TICKS = 5  # ticks of 0.1 s after which a report is sent even if nothing has changed


def _is_error(record: logging.LogRecord) -> bool:
    """Return whether a log record is about an error, not about a refused stream or a malformed message."""
    return not any(text in record.getMessage() for text in ("without completing handshake", "Invalid UTF-8 sequence"))


def run(checkpoint: str | pathlib.Path, settings: Settings) -> None:
    """Load and compile a model, then answer requests until SIGTERM or Ctrl-C.

    Raises:
        UserError: the model cannot be used, or the address is taken.
        KeyboardInterrupt: Ctrl-C, after the running requests.
        SystemExit: the terminal was closed.
    """
    with (
        bound(settings.host, settings.port) as listener,
        tempfile.TemporaryDirectory(prefix="ha2g-serve-", ignore_cleanup_errors=True) as folder,
    ):
        with stage("loading and compiling the model"):
            model = load(checkpoint)
            warm_up(model)
        service, was_interrupted = Service(model, settings, folder), False
        server = Server(service)
        try:
            server.run(sockets=[listener])
        except KeyboardInterrupt:  # uvicorn raises it when it has stopped
            was_interrupted = True
    leave(service, 128 + signal.SIGINT if was_interrupted else server.code)
    if was_interrupted:
        raise KeyboardInterrupt
    if server.code:
        raise SystemExit(server.code)


def leave(service: Service, code: int = 0) -> None:
    """End the process if a thread still computes after the grace, as Python would wait for it."""
    if service.is_computing:
        sys.stderr.flush()
        os._exit(code)


def warm_up(model: Model) -> None:
    """Compile the programs that the first requests would wait for."""
    model.generate(np.zeros(SAMPLE_RATE, np.float32))
    with contextlib.suppress(UserError):  # a model that reads words has no streams
        model.stream()
    gc.freeze()  # scanning all objects of the model would delay a frame by half a second


class Server(uvicorn.Server):
    """Server of one service, which waits for running requests and streams when it is stopped."""

    def __init__(self, service: Service):
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
            ws_ping_interval=None,  # no pong is read while sound waits; `idle_seconds` ends dead clients
            ws_per_message_deflate=False,
            timeout_graceful_shutdown=1,
        )
        super().__init__(config)
        logging.getLogger("uvicorn.error").addFilter(_is_error)
        self.service = service
        self.code = 0  # exit code

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        on_hangup(self._hang_up)
        self.service.counters.workers.set(1)
        if sockets:
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

    def _hang_up(self) -> None:
        self.should_exit = self.force_exit = True
        self.code = 128 + signal.SIGHUP


def main() -> int:
    """Run a worker until SIGTERM or the end of its parent, and return the exit code."""
    text = sys.stdin.read()
    if not text:  # the parent was stopped while it started this process
        return 0
    job = json.loads(text)
    settings = Settings(**job["settings"] | {"origins": tuple(job["settings"]["origins"])})
    # One core for each worker: the parent limits the threads of XLA, and those of BLAS are limited here.
    with socket.socket(fileno=int(sys.argv[1])) as control, threadpool_limits(1):
        try:
            model = load(job["checkpoint"])
            warm_up(model)
        except (UserError, OSError) as error:
            text = str(error) if isinstance(error, UserError) else f"{job['checkpoint']}: {reason(error).lower()}"
            control.sendall(Report(error=text).line())
            return 2
        service = Service(model, settings, job["folder"])
        control.setblocking(False)
        Worker(service, control).run()
    leave(service)
    return 0


class Worker(Server):
    """Server of the connections that arrive on a socket to the parent."""

    def __init__(self, service: Service, control: socket.socket):
        super().__init__(service)
        self._control, self._received = control, 0
        self._sent = Report()
        self._accepting: set[asyncio.Task[None]] = set()

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        del sockets
        await super().startup([])
        asyncio.get_running_loop().add_reader(self._control, self._receive)
        self.service.sessions.changed = self._report  # before the client hears of it and opens another stream

    async def on_tick(self, counter: int) -> bool:
        self._report(is_due=counter % _REPORT_TICKS == 0)
        return await super().on_tick(counter)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Tell the parent to give no more connections, then end as a server does."""
        self._report()
        await super().shutdown(sockets)
        asyncio.get_running_loop().remove_reader(self._control)

    def _report(self, *, is_due: bool = False) -> None:
        connections = len(self.server_state.connections) + len(self._accepting)
        report = Report(not self.should_exit, self._received, connections, self.service.sessions.are_taken)
        if is_due or report != self._sent:
            with contextlib.suppress(OSError):  # the parent is gone or busy, and hears the next one
                self._control.send(report.line())
                self._sent = report

    def _receive(self) -> None:
        """Take a connection; when the parent is gone, stop."""
        try:
            data, descriptors, _, _ = socket.recv_fds(self._control, 1, 1)
        except BlockingIOError:
            return
        except OSError:
            data, descriptors = b"", []
        if not data:
            asyncio.get_running_loop().remove_reader(self._control)
            self.should_exit = True
        else:  # a connection, of which the system has dropped the descriptor if this process has too many
            self._received += 1
            self._report()  # before anything is read: if this process is killed, other workers get the rest
        for descriptor in descriptors:
            task = asyncio.ensure_future(self._accept(socket.socket(fileno=descriptor)))
            self._accepting.add(task)
            task.add_done_callback(self._accepting.discard)

    async def _accept(self, connection: socket.socket) -> None:
        """Serve a connection as one that uvicorn has accepted."""
        protocol = self.config.http_protocol_class

        def create() -> asyncio.Protocol:
            return protocol(config=self.config, server_state=self.server_state, app_state=self.lifespan.state)  # pyrefly: ignore[unexpected-keyword]

        try:
            await asyncio.get_running_loop().connect_accepted_socket(create, connection)
        except OSError:  # the client has closed it
            connection.close()


if __name__ == "__main__":
    sys.exit(main())
