"""Child processes whose output goes to a file, and which are stopped when this process is stopped."""

import contextlib
import pathlib
import signal
import subprocess
from collections.abc import Iterator, Mapping, Sequence

from ha2g_jax.stopping import on_stop_signals


class Stop:
    """State of a request to stop, which is passed on to child processes.

    Attributes:
        number: number of the signal that requested the stop, None before.
    """

    def __init__(self) -> None:
        self.number: int | None = None
        self._processes: set[subprocess.Popen] = set()

    def handle(self, number: int) -> None:
        """Ask the child processes to save and end; kill them if called again."""
        is_first = self.number is None
        self.number = number
        for process in list(self._processes):
            self._end(process, signal.SIGTERM if is_first else signal.SIGKILL)

    def wait(self, process: subprocess.Popen) -> int:
        """Wait for a child process, which is ended when a stop is requested, and return its exit code."""
        self._processes.add(process)
        try:
            if self.number is not None:  # the signal came while the process was being started
                self._end(process, signal.SIGTERM)
            return process.wait()
        finally:
            self._processes.discard(process)

    def _end(self, process: subprocess.Popen, number: int) -> None:
        if process.poll() is None:
            process.send_signal(number)


@contextlib.contextmanager
def stop_signals() -> Iterator[Stop]:
    """Handle SIGTERM, Ctrl-C and a closed terminal (except under nohup) by a `Stop` in this context."""
    stop = Stop()
    with on_stop_signals(stop.handle, (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)):
        yield stop


def run_logged(
    command: Sequence[str],
    log: pathlib.Path,
    stop: Stop,
    *,
    given: bytes = b"",
    environment: Mapping[str, str] | None = None,
) -> str | None:
    """Run a command to its end, or until a stop is requested.

    Args:
        command: program and arguments.
        log: file to which the output of the command is appended.
        stop: request to stop, which ends the command.
        given: standard input of the command.
        environment: environment variables of the command, by default those of this process.

    Returns:
        None if the command succeeded; otherwise the last line of its output and its exit code.
    """
    with log.open("ab") as file:
        # In a new session, so that Ctrl-C in the terminal reaches it only through `stop`.
        process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=file, stderr=file, env=environment, start_new_session=True
        )
        assert process.stdin is not None
        with contextlib.suppress(BrokenPipeError), process.stdin:  # the process died, which its exit code shows
            process.stdin.write(given)
        code = stop.wait(process)
    if code == 0:
        return None
    printed = [line.strip() for line in log.read_text(errors="replace").splitlines() if line.strip()]
    return f"{printed[-1] if printed else 'no output'} (exit code {code}; see {log})"
