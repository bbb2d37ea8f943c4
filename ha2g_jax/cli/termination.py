"""SIGTERM ends a command as Ctrl-C does, so that its temporary files are deleted."""

import contextlib
import signal
import threading
from collections.abc import Iterator
from types import FrameType
from typing import NoReturn


@contextlib.contextmanager
def termination() -> Iterator[None]:
    """Turn SIGTERM into SystemExit with code 143 in this context, unless the program handles it already."""
    is_main = threading.current_thread() is threading.main_thread()  # Python allows signal handlers only there
    if not is_main or signal.getsignal(signal.SIGTERM) != signal.SIG_DFL:
        yield
        return
    signal.signal(signal.SIGTERM, _end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _end(number: int, _: FrameType | None) -> NoReturn:
    raise SystemExit(128 + number)
