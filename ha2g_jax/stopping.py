"""Requests to stop this process: SIGTERM, Ctrl-C, or a closed terminal, which `on_stop_signals` handles."""

import _thread
import contextlib
import os
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NoReturn

STOP_SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
"""Ctrl-C, SIGTERM and, except on Windows, SIGHUP, by which a process learns that its terminal is closed."""

# Python handles a signal between two of its own instructions, and compiling the step is one that may take a minute.
_PATIENCE = 5.0  # seconds
_NOTHING_LOST = "stopped before the first step: nothing was lost; the same command continues\n"
_SOON = 0.1  # seconds until a signal is repeated


def signal_name(number: int) -> str:
    """Return the name of a signal, such as "SIGKILL", or "signal 40" for one without a name."""
    return signal.Signals(number).name if number in set(signal.Signals) else f"signal {number}"


@contextlib.contextmanager
def on_stop_signals(
    handle: Callable[[int], None],
    numbers: Sequence[signal.Signals] = STOP_SIGNALS,
    *,
    once: Sequence[signal.Signals] = (),
) -> Iterator[None]:
    """Call a function with the number of each stop signal that arrives in this context.

    The function is called between two instructions of the main thread. In other threads, and for signals that are
    ignored, such as SIGHUP under nohup, nothing changes. Signals in `once` are handled only once, and then have their
    previous effect.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    previous = {n: handler for n in numbers if (handler := signal.getsignal(n)) != signal.SIG_IGN}

    def receive(number: int, _: object) -> None:
        if number in once:
            signal.signal(number, previous[signal.Signals(number)])
        handle(number)

    for number in previous:
        signal.signal(number, receive)
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def ending_on_signals() -> Iterator[None]:
    """Turn stop signals that would kill the process into SystemExit 128 + number, so that it cleans up.

    Python ignores exceptions in callbacks of the garbage collector, of which JAX has one, and in `__del__`. A signal
    that arrives there, Ctrl-C included, is repeated soon after.
    """
    report = sys.unraisablehook

    def end(number: int) -> NoReturn:
        raise SystemExit(128 + number)

    def repeat(ignored: Any) -> None:
        if not issubclass(ignored.exc_type, SystemExit | KeyboardInterrupt):
            return report(ignored)
        number = ignored.exc_value.code - 128 if ignored.exc_type is SystemExit else signal.SIGINT
        threading.Timer(_SOON, _thread.interrupt_main, [number]).start()

    sys.unraisablehook = repeat
    try:
        with on_stop_signals(end, [n for n in STOP_SIGNALS if signal.getsignal(n) == signal.SIG_DFL]):
            yield
    finally:
        sys.unraisablehook = report


@contextlib.contextmanager
def leaving_on_signals() -> Iterator[None]:
    """End the process at once on a stop signal, also while the main thread is busy in a compiler.

    There is no exception, because one in a callback would crash the compiler; so nothing may be half-written here.
    """

    def watch(receiver: socket.socket) -> None:
        while number := receiver.recv(1):
            if number[0] in STOP_SIGNALS:
                _leave(128 + number[0], "\nha2g: interrupted\n")

    with _watching(watch), on_stop_signals(lambda _: None):  # the main thread leaves it to the watcher
        yield


class Stop:
    """Request to end a training. Before `begin` the run has nothing to save, and a signal ends it at once."""

    def __init__(self) -> None:
        self._asked, self._begun = threading.Event(), threading.Event()
        self._may_raise = True

    def enter_compiler(self) -> None:
        """Declare that signals must not raise from now on: an exception in a callback would crash a compiler."""
        self._may_raise = False

    def begin(self) -> None:
        """Declare that from now on there are steps to save: a signal is only recorded, and the loop ends the run."""
        self._begun.set()

    @property
    def has_begun(self) -> bool:
        """Whether `begin` was called."""
        return self._begun.is_set()

    def is_set(self) -> bool:
        """Return whether the end of the run was requested."""
        return self._asked.is_set()

    def ask(self, number: int = signal.SIGTERM) -> None:
        """Request the end of the run; before its first step, end the process."""
        del number
        self._asked.set()
        if self.has_begun:
            return
        if not self._may_raise:
            self.leave()
        _say(_NOTHING_LOST)
        raise SystemExit(0)

    def leave(self) -> NoReturn:
        """End the process without an exception."""
        _leave(0, _NOTHING_LOST)


@contextlib.contextmanager
def stop_after_step() -> Iterator[Stop]:
    """Turn stop signals into a `Stop`; a second Ctrl-C interrupts at once."""
    stop = Stop()
    finished = threading.Event()

    def watch(receiver: socket.socket) -> None:
        """End the process if the main thread is busy in a compiler and does not handle the signal itself."""
        while number := receiver.recv(1):
            if number[0] not in STOP_SIGNALS or stop.has_begun:
                continue
            if not finished.wait(_PATIENCE) and not stop.has_begun:
                stop.leave()

    with _watching(watch):
        try:
            with on_stop_signals(stop.ask, once=(signal.SIGINT,)):  # a scheduler may send SIGTERM twice
                yield stop
        finally:
            finished.set()


@contextlib.contextmanager
def _watching(watch: Callable[[socket.socket], None]) -> Iterator[None]:
    """Let a thread run a function with a socket that receives the number of each signal when it arrives.

    In other threads than the main one, signals are left to it.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    receiver, sender = socket.socketpair()
    sender.setblocking(False)
    previous = signal.set_wakeup_fd(sender.fileno(), warn_on_full_buffer=False)
    watcher = threading.Thread(target=watch, args=(receiver,), daemon=True)
    watcher.start()
    try:
        yield
    finally:
        signal.set_wakeup_fd(previous)
        sender.close()  # ends the watcher
        watcher.join()
        receiver.close()


def _leave(status: int, message: str) -> NoReturn:
    _say(message)
    os._exit(status)


def _say(message: str) -> None:
    with contextlib.suppress(OSError):  # of a terminal that is closed
        sys.stderr.write(message)
        sys.stderr.flush()
