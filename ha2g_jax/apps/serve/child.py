"""A worker as its parent sees it."""

import asyncio
import collections
import dataclasses
import json
import os
import pathlib
import signal
import socket
import sys
import time

from prometheus_client.multiprocess import mark_process_dead

from ha2g_jax.apps.serve.counters import FOLDER
from ha2g_jax.apps.serve.report import Report
from ha2g_jax.apps.serve.settings import Settings
from ha2g_jax.errors import UserError

_SILENT_SECONDS = 2.0  # without a report, after which connections go to other workers


class Child:
    """A process of a worker.

    Args:
        process: process.
        control: socket to it.
        folder: folder of the values of counters.

    Attributes:
        report: what it told last.
        unreceived: connections that were given to it, and of which it has not told that it received them.
    """

    def __init__(self, process: asyncio.subprocess.Process, control: socket.socket, folder: str):
        self._process, self._control, self._folder = process, control, folder
        self._heard, self.report = time.monotonic(), Report()
        self.unreceived: collections.deque[socket.socket] = collections.deque()
        self._given = 0

    @classmethod
    async def start(cls, checkpoint: str, settings: Settings, folder: str) -> "Child":
        """Start a worker.

        Args:
            checkpoint: model.
            settings: settings of the service.
            folder: folder for temporary files.

        Raises:
            OSError: the system cannot start a process.
        """
        control, theirs = socket.socketpair()
        control.setblocking(False)
        counts = pathlib.Path(folder) / "counters"
        counts.mkdir(exist_ok=True)
        with theirs:
            process = await asyncio.create_subprocess_exec(
                *(sys.executable, "-m", "ha2g_jax.apps.serve.worker", str(theirs.fileno())),
                stdin=asyncio.subprocess.PIPE,
                pass_fds=[theirs.fileno()],
                env=os.environ | {FOLDER: str(counts), "PJRT_NPROC": "1"},
                start_new_session=True,  # so that Ctrl-C in the terminal reaches the parent alone
            )
        job = {"checkpoint": checkpoint, "settings": dataclasses.asdict(settings), "folder": folder}
        assert process.stdin is not None
        process.stdin.write(json.dumps(job).encode())
        process.stdin.close()
        return cls(process, control, str(counts))

    @property
    def is_ready(self) -> bool:
        """Whether it takes connections."""
        return self.report.is_ready

    @property
    def rank(self) -> tuple[bool, bool, int]:
        """Return its place in the order in which workers are given connections: those that are free come first."""
        is_silent = time.monotonic() - self._heard > _SILENT_SECONDS
        return is_silent, self.report.is_full, self.report.open + len(self.unreceived)

    def give(self, connection: socket.socket) -> bool:
        """Send it a connection if it takes any, and return whether that succeeded.

        Args:
            connection: connection to a client, which is closed here when the worker has received it.
        """
        if not self.is_ready:
            return False
        try:
            socket.send_fds(self._control, [b"c"], [connection.fileno()])
        except OSError:  # it has ended, or has not read for long
            return False
        self._given += 1
        self.unreceived.append(connection)
        return True

    async def watch(self) -> str:
        """Read its reports until it ends, and return how it ended.

        Raises:
            UserError: it cannot begin.
        """
        loop, rest = asyncio.get_running_loop(), b""
        try:
            while data := await loop.sock_recv(self._control, 1 << 16):
                *lines, rest = (rest + data).split(b"\n")
                if lines:
                    self.report, self._heard = Report.parse(lines[-1]), time.monotonic()
                    while len(self.unreceived) > self._given - self.report.received:
                        self.unreceived.popleft().close()
        except ConnectionError:  # it was killed with connections that it had not received
            pass
        error, self.report = self.report.error, Report()
        code = await self.end()
        if error is not None:
            raise UserError(error)
        how = f"was ended by {signal.Signals(-code).name}" if code < 0 else f"has ended with code {code}"
        return f"worker {self._process.pid} {how}"

    def signal(self, number: int) -> None:
        """Send it a signal.

        Args:
            number: number of the signal.
        """
        if self._process.returncode is None:
            self._process.send_signal(number)

    async def end(self) -> int:
        """Wait for its end, and return its exit code."""
        code = await self._process.wait()
        self._control.close()
        mark_process_dead(self._process.pid, self._folder)
        return code
