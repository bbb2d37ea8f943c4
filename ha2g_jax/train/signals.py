"""End a run on SIGTERM or Ctrl-C after the current step, with a checkpoint."""

import contextlib
import os
import signal
import socket
import sys
import threading
from collections.abc import Iterator
from types import FrameType

# Python handles a signal between two of its own instructions, and compiling the step is one that takes a minute.
_PATIENCE = 5.0  # seconds


class Stop:
    """Request to end the run. Before `begin` the run has nothing to save, and a signal ends it at once."""

    def __init__(self) -> None:
        self._asked, self._begun = threading.Event(), threading.Event()
        self.may_raise = True

    def enter_compiler(self) -> None:
        """Declare that a signal must not raise from now on: an exception in a callback would crash a compiler."""
        self.may_raise = False

    def begin(self) -> None:
        """Declare that there are steps to save from now on: a signal is only recorded, and the loop ends the run."""
        self._begun.set()

    @property
    def has_begun(self) -> bool:
        """Whether `begin` was called."""
        return self._begun.is_set()

    def ask(self) -> None:
        """Request the end of the run."""
        self._asked.set()

    def is_set(self) -> bool:
        """Return whether the end of the run was requested."""
        return self._asked.is_set()


@contextlib.contextmanager
def stop_signals() -> Iterator[Stop]:
    """Turn SIGTERM and Ctrl-C into a `Stop`; a second Ctrl-C interrupts at once."""
    stop = Stop()
    if threading.current_thread() is not threading.main_thread():  # Python allows signal handlers only there
        yield stop
        return
    previous = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}

    def handle(number: int, _: FrameType | None) -> None:
        stop.ask()
        if number == signal.SIGINT:
            signal.signal(number, previous[signal.SIGINT])  # not for SIGTERM, which a scheduler may send twice
        if stop.has_begun:
            return
        if not stop.may_raise:
            _leave()
        _say_nothing_lost()
        raise SystemExit(0)

    receiver, sender = socket.socketpair()
    sender.setblocking(False)
    previous_wakeup = signal.set_wakeup_fd(sender.fileno(), warn_on_full_buffer=False)
    finished = threading.Event()
    watcher = threading.Thread(target=_watch, args=(receiver, stop, finished), daemon=True)
    watcher.start()
    for number in previous:
        signal.signal(number, handle)
    try:
        yield stop
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
        signal.set_wakeup_fd(previous_wakeup)
        finished.set()
        sender.close()  # ends the watcher
        watcher.join()
        receiver.close()


def _watch(receiver: socket.socket, stop: Stop, finished: threading.Event) -> None:
    """End the process if the main thread is busy in a compiler and does not handle the signal itself."""
    while number := receiver.recv(1):
        if number[0] not in (signal.SIGTERM, signal.SIGINT) or stop.has_begun:
            continue
        if not finished.wait(_PATIENCE) and not stop.has_begun:
            _leave()


def _leave() -> None:
    _say_nothing_lost()
    os._exit(0)


def _say_nothing_lost() -> None:
    sys.stderr.write("stopped before the first step: nothing was lost; the same command continues\n")
    sys.stderr.flush()
