"""Several workers at one address: this process takes the connections and gives each to the worker with the fewest.

It loads no model. The workers are processes of their own, see `server.main`; one that has ended is replaced.
"""

import asyncio
import collections
import dataclasses
import json
import os
import pathlib
import signal
import socket
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from typing import NamedTuple, NoReturn

from prometheus_client.multiprocess import mark_process_dead
from tqdm import tqdm

from ha2g_jax.apps.serve.service import FOLDER
from ha2g_jax.apps.serve.settings import Settings, bound, url
from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import reason
from ha2g_jax.progress import stage
from ha2g_jax.stopping import signal_name

_FIRST_WAIT, _MOST_WAIT = 1.0, 30.0  # seconds before a worker is replaced
_LASTING_SECONDS = 60.0  # after which the next wait is the first again
_BACKLOG = 2048
_TICK = 0.1  # seconds between two looks for a worker that takes a connection
MARGIN = 10.0  # seconds after the grace in which workers end by themselves
_SILENT_SECONDS = 2.0  # without a report, after which connections go to other workers


class Report(NamedTuple):
    """What a worker reports to its parent.

    Attributes:
        is_ready: whether it takes connections.
        received: connections that it has received so far.
        open: connections that are open.
        is_full: whether all its slots for streams are taken.
        error: reason for which it cannot begin, one line.
    """

    is_ready: bool = False
    received: int = 0
    open: int = 0
    is_full: bool = False
    error: str | None = None

    def line(self) -> bytes:
        return json.dumps(self).encode() + b"\n"

    @classmethod
    def parse(cls, line: bytes) -> "Report":
        return cls(*json.loads(line))


class Child:
    """A worker as its parent sees it: its process, and a socket to it.

    Attributes:
        report: its last report.
        unreceived: connections that were given to it and that it has not yet reported as received.
    """

    def __init__(self, process: asyncio.subprocess.Process, control: socket.socket, folder: str):
        self._process, self._control, self._folder = process, control, folder
        self._heard, self.report = time.monotonic(), Report()
        self.unreceived: collections.deque[socket.socket] = collections.deque()
        self._given = 0

    @classmethod
    async def start(cls, checkpoint: str, settings: Settings, folder: str) -> "Child":
        """Start a worker.

        Raises:
            OSError: the system cannot start a process.
        """
        control, theirs = socket.socketpair()
        control.setblocking(False)
        counts = pathlib.Path(folder) / "counters"
        counts.mkdir(parents=True, exist_ok=True)
        with theirs:
            process = await asyncio.create_subprocess_exec(
                *(sys.executable, "-m", "ha2g_jax.apps.serve.server", str(theirs.fileno())),
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
    def rank(self) -> tuple[bool, bool, int]:
        """Return the sort key by which workers are given connections: free ones come first."""
        is_silent = time.monotonic() - self._heard > _SILENT_SECONDS
        return is_silent, self.report.is_full, self.report.open + len(self.unreceived)

    def give(self, connection: socket.socket) -> bool:
        """Send it a connection, which is closed here when it has been received, and return whether that succeeded."""
        if not self.report.is_ready:
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
        how = f"was ended by {signal_name(-code)}" if code < 0 else f"has ended with code {code}"
        return f"worker {self._process.pid} {how}"

    def signal(self, number: int) -> None:
        if self._process.returncode is None:
            self._process.send_signal(number)

    async def end(self) -> int:
        """Wait for its end, and return its exit code."""
        code = await self._process.wait()
        self._control.close()
        mark_process_dead(self._process.pid, self._folder)
        return code


def run(checkpoint: str | pathlib.Path, settings: Settings) -> None:
    """Start the workers, then share the connections among them until SIGTERM or Ctrl-C.

    Raises:
        UserError: the model cannot be used, the address is taken, or a first worker has failed.
        KeyboardInterrupt: Ctrl-C, after the running requests.
        SystemExit: the terminal was closed.
    """
    if not hasattr(socket, "send_fds"):
        raise UserError("this system cannot share connections among processes; leave out --workers")
    with (
        bound(settings.host, settings.port) as listener,
        tempfile.TemporaryDirectory(prefix="ha2g-serve-", ignore_cleanup_errors=True) as folder,
    ):
        number = asyncio.run(Workers(str(checkpoint), settings, listener, folder).run())
    if number == signal.SIGINT:
        raise KeyboardInterrupt
    if number != signal.SIGTERM:
        raise SystemExit(128 + number)


def on_hangup(call: Callable[[], object]) -> None:
    """Call a function of the running event loop when the terminal is closed, except under nohup and on Windows."""
    is_main = threading.current_thread() is threading.main_thread()
    if is_main and hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:
        asyncio.get_running_loop().add_signal_handler(signal.SIGHUP, call)


def next_wait(wait: float, lasted: float) -> float:
    """Return the seconds before a worker is replaced; the wait grows if workers end soon after their start.

    Args:
        wait: seconds before this one was started.
        lasted: seconds from its start to its end.
    """
    return _FIRST_WAIT if lasted > _LASTING_SECONDS else min(max(2 * wait, _FIRST_WAIT), _MOST_WAIT)


class Workers:
    """The workers of a service, with the bound socket at whose address it listens."""

    def __init__(self, checkpoint: str, settings: Settings, listener: socket.socket, folder: str):
        self._checkpoint, self._settings, self._folder = checkpoint, settings, folder
        self._listener, self._is_open = listener, False
        self._children: set[Child] = set()
        self._connections: asyncio.Queue[socket.socket] = asyncio.Queue()
        self._signals: asyncio.Queue[int] = asyncio.Queue()

    @property
    def _num_ready(self) -> int:
        return sum(child.report.is_ready for child in self._children)

    async def run(self) -> int:
        """Run until a signal, and return its number when the workers have ended.

        Raises:
            UserError: a first worker has failed, or the model cannot be loaded again and no worker is left.
        """
        loop = asyncio.get_running_loop()
        for number in (signal.SIGTERM, signal.SIGINT):
            loop.add_signal_handler(number, self._signals.put_nowait, number)
        on_hangup(lambda: self._signals.put_nowait(signal.SIGHUP))
        keepers = [self._keep(is_first=number == 0) for number in range(self._settings.workers)]
        tasks = [asyncio.ensure_future(task) for task in (self._listen(), self._share(), *keepers)]
        stopped = asyncio.ensure_future(self._signals.get())
        try:
            done, _ = await asyncio.wait([stopped, *tasks], return_when=asyncio.FIRST_COMPLETED)
            number = done.pop().result()  # of the others, none ends but by an error
            if number not in (signal.SIGTERM, signal.SIGINT):
                self._signal(signal.SIGKILL)
            return number
        finally:
            self._listener.close()
            for task in (stopped, *tasks):
                task.cancel()
            await asyncio.wait([stopped, *tasks])
            await self._end()

    async def _keep(self, *, is_first: bool) -> NoReturn:
        """Keep a worker running: start it, and another one when it has ended."""
        if not is_first:  # the first one compiles the programs that the others then read
            await self._until(lambda: self._num_ready > 0)
        wait = 0.0
        while True:
            began = time.monotonic()
            try:
                ending = await self._life()
            except UserError as error:
                if not (self._is_open and self._num_ready):
                    raise
                ending = str(error)
            if not self._is_open:
                raise UserError(f"{ending} before it was ready; if memory is short, give fewer --workers")
            wait = next_wait(wait, time.monotonic() - began)
            tqdm.write(f"ha2g: {ending}; another one starts in {wait:g} s", file=sys.stderr)
            await asyncio.sleep(wait)

    async def _life(self) -> str:
        """Start a worker, and return how it ended.

        Raises:
            UserError: it cannot begin.
        """
        try:
            child = await Child.start(self._checkpoint, self._settings, self._folder)
        except OSError as error:
            return f"a worker cannot be started ({reason(error).lower()})"
        self._children.add(child)
        ending = await child.watch()
        self._children.discard(child)
        for connection in child.unreceived:  # nothing of them was read
            self._connections.put_nowait(connection)
        return ending

    async def _listen(self) -> NoReturn:
        """Take connections when all workers are ready."""
        with stage("loading and compiling the model"):
            await self._until(lambda: self._num_ready == self._settings.workers)
        self._listener.listen(_BACKLOG)
        self._listener.setblocking(False)
        self._is_open = True
        tqdm.write(f"ha2g: ready at {url(self._listener)}", file=sys.stderr)
        while True:
            await self._until(lambda: self._num_ready > 0)
            try:
                connection, _ = await asyncio.get_running_loop().sock_accept(self._listener)
            except OSError:  # the client is gone, or this process has too many open files
                await asyncio.sleep(_TICK)
            else:
                self._connections.put_nowait(connection)

    async def _share(self) -> NoReturn:
        """Give each connection to a worker."""
        while True:
            connection = await self._connections.get()
            while not any(child.give(connection) for child in sorted(self._children, key=lambda child: child.rank)):
                await asyncio.sleep(_TICK)

    async def _until(self, condition: Callable[[], bool]) -> None:
        while not condition():
            await asyncio.sleep(_TICK)

    async def _end(self) -> None:
        """Stop all workers; a second signal ends what they do, and those that do not end are killed."""
        if not self._children:
            return
        self._signal(signal.SIGTERM)
        ended = asyncio.gather(*(child.end() for child in self._children))
        again = asyncio.ensure_future(self._signals.get())
        await asyncio.wait([ended, again], timeout=self._settings.grace + MARGIN, return_when=asyncio.FIRST_COMPLETED)
        self._signal(signal.SIGTERM if again.done() else signal.SIGKILL)
        again.cancel()
        try:
            await asyncio.wait_for(ended, MARGIN)
        except TimeoutError:
            self._signal(signal.SIGKILL)

    def _signal(self, number: int) -> None:
        for child in self._children:
            child.signal(number)
