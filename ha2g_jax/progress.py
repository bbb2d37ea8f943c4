"""Progress of long work on stderr: a bar or a clock on a terminal, and a plain line every ten seconds elsewhere."""

import contextlib
import math
import shutil
import sys
import threading
import time
from collections.abc import Iterator
from typing import Any

from tqdm import tqdm

_TICK = 1.0  # seconds between two times that a clock shows on a terminal
_LINE_SECONDS = 10.0  # seconds between two plain lines


def progress_bar(desc: str, total: int | None = None, unit: str = "it") -> tqdm:
    """Return a bar, or without a `total` a clock, that is removed when it is closed; a file or a pipe gets plain lines.

    Work that ends within ten seconds prints no plain line, so that an error stays the only line of a command.
    """
    if sys.stderr.isatty():
        style: dict[str, Any] = {} if total is not None else {"bar_format": "{desc} ... {elapsed}"}
        size = shutil.get_terminal_size()  # 80x24 for a terminal that has no size, on which tqdm shows nothing
        return tqdm(desc=desc, total=total, unit=unit, leave=False, ncols=size.columns, nrows=size.lines, **style)
    return _Lines(desc=desc, total=total, unit=unit, leave=False)


@contextlib.contextmanager
def stage(desc: str) -> Iterator[None]:
    """Say on stderr what the work of the context is, such as "loading the model", and how long it has taken."""
    done = threading.Event()
    with progress_bar(desc) as bar:
        interval = _LINE_SECONDS if isinstance(bar, _Lines) else _TICK
        thread = threading.Thread(target=_tick, args=(bar, done, interval), daemon=True)
        thread.start()
        try:
            yield
        finally:
            done.set()
            thread.join()


def _tick(bar: tqdm, done: threading.Event, interval: float) -> None:
    while not done.wait(interval):
        bar.refresh()


class _Lines(tqdm):
    """A bar that prints a line every ten seconds, for a file or a pipe."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        self._shown_at = time.monotonic()
        count = "" if kwargs.get("total") is None else ": {n_fmt} of {total_fmt} {unit}, {remaining} left"
        super().__init__(
            *args,
            delay=_LINE_SECONDS,
            mininterval=_LINE_SECONDS,
            miniters=1,
            bar_format="{desc}" + count + " ({elapsed} so far)",
            **kwargs,
        )

    def display(self, msg: str | None = None, pos: int | None = None) -> None:
        """Print the state of the bar as a line, unless tqdm would restore it after another line was written."""
        del pos
        if (now := time.monotonic()) - self._shown_at < 0.9 * _LINE_SECONDS:
            return
        self._shown_at = now
        self.fp.write(f"{msg or self}\n")
        self.fp.flush()

    def clear(self, nolock: bool = False) -> None:
        """Leave the printed lines."""

    def close(self) -> None:
        """End the bar without a last line."""
        self.delay = math.inf  # before the end of the delay nothing is shown, and nothing has to be removed
        super().close()
