"""Processes of their own, whose output goes to a file, and that are told to stop when this one is."""

import contextlib
import pathlib
import signal
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from types import FrameType


class Stop:
    """Whether a signal asked to stop, and the processes that it is passed on to."""

    def __init__(self) -> None:
        self.number: int | None = None
        self._processes: set[subprocess.Popen] = set()

    def handle(self, number: int, _: FrameType | None = None) -> None:
        """Asks the processes to save and end; ends them at once if asked again."""
        is_first = self.number is None
        self.number = number
        for process in list(self._processes):
            self._end(process, signal.SIGTERM if is_first else signal.SIGKILL)

    def wait(self, process: subprocess.Popen) -> int:
        """The exit code of a process that ends when this stops."""
        self._processes.add(process)
        try:
            if self.number is not None:  # it came while the process was being started
                self._end(process, signal.SIGTERM)
            return process.wait()
        finally:
            self._processes.discard(process)

    def _end(self, process: subprocess.Popen, number: int) -> None:
        if process.poll() is None:
            process.send_signal(number)


@contextlib.contextmanager
def stop_signals() -> Iterator[Stop]:
    """Turns SIGTERM, Ctrl-C and a closed terminal, except under nohup, into a `Stop`."""
    stop = Stop()
    numbers = [n for n in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP) if signal.getsignal(n) != signal.SIG_IGN]
    previous = {number: signal.signal(number, stop.handle) for number in numbers}
    try:
        yield stop
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def run_logged(
    command: Sequence[str],
    log: pathlib.Path,
    stop: Stop,
    *,
    given: bytes = b"",
    environment: Mapping[str, str] | None = None,
) -> str | None:
    """Runs a command to its end, or until `stop`.

    Args:
        command: the program and its arguments.
        log: what it prints is added to this file.
        stop: ends it.
        given: what it can read from its standard input.
        environment: of the process, by default that of this one.

    Returns:
        None if it ended well; else the last line that it printed and its exit code.
    """
    with log.open("ab") as file:
        # In a session of its own, so that the terminal's Ctrl-C comes to it only by way of `stop`.
        process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=file, stderr=file, env=environment, start_new_session=True
        )
        assert process.stdin is not None
        with contextlib.suppress(BrokenPipeError), process.stdin:  # it died: the exit code tells
            process.stdin.write(given)
        code = stop.wait(process)
    if code == 0:
        return None
    printed = [line.strip() for line in log.read_text(errors="replace").splitlines() if line.strip()]
    return f"{printed[-1] if printed else 'it printed nothing'} (exit code {code}; see {log})"
