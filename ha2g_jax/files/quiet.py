"""Suppression of what C libraries print on the standard error where a message of this program says it."""

import contextlib
import os
import pathlib
import threading
from collections.abc import Iterator

_lock = threading.Lock()
_kept: list[int] = []  # the standard error while it is replaced, once for each context that is open


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Discard what is written to the standard error of the process, by any of its threads, in this context.

    Contexts of several threads may overlap; the last one that is left restores the standard error.
    """
    with _lock:
        try:
            kept = _kept[0] if _kept else os.dup(2)
        except OSError:  # it is closed
            kept = None
        if kept is not None:
            if not _kept:
                with pathlib.Path(os.devnull).open("wb") as nothing:
                    os.dup2(nothing.fileno(), 2)
            _kept.append(kept)
    try:
        yield
    finally:
        with _lock:
            if kept is not None:
                _kept.pop()
                if not _kept:
                    os.dup2(kept, 2)
                    os.close(kept)
