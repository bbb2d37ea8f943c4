"""A worker: a process that takes the connections which its parent gives it, see `workers`.

Its standard input is JSON: the model, the settings, and a folder for temporary files. On the socket whose number is its
argument it receives connections, and sends a `Report` as a line of JSON when something has changed.
"""

import asyncio
import contextlib
import json
import socket
import sys

from threadpoolctl import threadpool_limits

from ha2g_jax.apps.serve.report import Report
from ha2g_jax.apps.serve.server import Server, leave, warm_up
from ha2g_jax.apps.serve.service import Service
from ha2g_jax.apps.serve.settings import Settings
from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import reason
from ha2g_jax.synthesis.model import load

_REPORT_TICKS = 5  # of 0.1 s, after which a report is sent that has no news


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
    """Server of the connections that arrive on a socket.

    Args:
        service: service to run.
        control: socket to the parent.
    """

    def __init__(self, service: Service, control: socket.socket):
        super().__init__(service)
        self._control, self._received = control, 0
        self._sent = Report()
        self._accepting: set[asyncio.Task[None]] = set()

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Begin to take connections."""
        del sockets
        await super().startup([])
        asyncio.get_running_loop().add_reader(self._control, self._receive)
        self.service.sessions.changed = self._report  # before the client hears of it and opens another stream

    async def on_tick(self, counter: int) -> bool:
        """Tell the parent what has changed."""
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
        for descriptor in descriptors:
            self._received += 1
            self._report()  # before anything is read: if this process is killed, other workers get the rest
            task = asyncio.ensure_future(self._accept(socket.socket(fileno=descriptor)))
            self._accepting.add(task)
            task.add_done_callback(self._accepting.discard)

    async def _accept(self, connection: socket.socket) -> None:
        """Serve a connection as one that uvicorn has accepted."""
        protocol = self.config.http_protocol_class

        def create() -> asyncio.Protocol:
            return protocol(config=self.config, server_state=self.server_state, app_state=self.lifespan.state)  # pyright: ignore[reportCallIssue]

        try:
            await asyncio.get_running_loop().connect_accepted_socket(create, connection)
        except OSError:  # the client has closed it
            connection.close()


if __name__ == "__main__":
    sys.exit(main())
