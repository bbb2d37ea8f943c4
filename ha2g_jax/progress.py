"""Progress of long work on stderr: a bar or a clock on a terminal, and otherwise a plain line now and then."""

import contextlib
import math
import shutil
import sys
import threading
import time
from collections.abc import Iterable, Iterator
from typing import Any, TypeVar

from tqdm import tqdm

T = TypeVar("T")

_TICK = 1.0  # seconds between updates of a clock on a terminal
_LINE_SECONDS = 10.0  # seconds between two plain lines
_PART_DELAY = 2.0  # seconds before the progress of a part is shown
_COUNT = "{n_fmt} of {total_fmt} {unit}, {remaining} left{postfix}"
_PLURALS = {"corpus": "corpora", "shot or clip": "shots or clips"}


def counted(number: int, noun: str) -> str:
    """Return a number with its noun, such as "1 recording" or "1,766 recordings"."""
    return f"{number:,} {plural(noun, number)}"


def plural(noun: str, number: int) -> str:
    """Return the noun for a number of things: "clip" for 1, else "clips"."""
    return noun if number == 1 else _PLURALS.get(noun, f"{noun}s")


def progress_bar(
    desc: str,
    total: int | None = None,
    unit: str = "",
    *,
    initial: int = 0,
    is_shown: bool = True,
    is_part: bool = False,
    leave: bool = False,
    line_seconds: float | None = None,
) -> tqdm:
    """Return a bar, or without a `total` a clock, that is removed when it is closed; a file or a pipe gets plain lines.

    Work that ends before the first plain line prints none, so that an error stays the only line of a command.

    Args:
        desc: name of the work.
        unit: singular noun of the things that are counted, such as "clip".
        initial: number of things that are already done.
        is_shown: whether anything is shown.
        is_part: whether it is part of work with its own progress; then it is only shown on a terminal, after 2 s.
        leave: whether the last state of a bar stays on a terminal.
        line_seconds: time between two plain lines (default: 10).
    """
    is_terminal = sys.stderr.isatty()
    if not is_shown or (is_part and not is_terminal):
        return tqdm(disable=True)
    options: dict[str, Any] = {"desc": desc, "total": total, "initial": initial, "unit": plural(unit, total or 0)}
    if not is_terminal:
        return _Lines(_LINE_SECONDS if line_seconds is None else line_seconds, **options)
    size = shutil.get_terminal_size()  # 80x24 for a terminal that has no size, on which tqdm shows nothing
    style = "{desc} ... {elapsed}" if total is None else "{desc}: {percentage:3.0f} %|{bar}| " + _COUNT
    options |= {"leave": leave, "delay": _PART_DELAY if is_part else 0, "smoothing": 0.05}
    return tqdm(**options, ncols=size.columns, nrows=size.lines, bar_format=style)


def track(items: Iterable[T], desc: str, unit: str, total: int | None = None) -> Iterator[T]:
    """Yield the items of an iterable, with length `total` if it has none, and show the progress as a bar."""
    count = len(items) if total is None else total  # pyrefly: ignore[bad-argument-type]
    with progress_bar(desc, count, unit) as bar:
        for item in items:
            yield item
            bar.update()


@contextlib.contextmanager
def stage(desc: str) -> Iterator[None]:
    """Show on stderr what this context does, such as "loading the model", and how long it has taken."""
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
    """A bar that prints a line every `seconds`, for a file or a pipe."""

    def __init__(self, seconds: float, **options: Any) -> None:
        self._seconds, self._shown_at = seconds, time.monotonic()
        style = "{desc}" + ("" if options["total"] is None else ": " + _COUNT) + " ({elapsed} so far)"
        super().__init__(
            **options,
            leave=False,
            delay=seconds,
            mininterval=seconds,
            miniters=1,
            bar_format=style,
        )

    def display(self, msg: str | None = None, pos: int | None = None) -> None:
        """Print the state of the bar as a line, unless tqdm would restore it after another line was written."""
        del pos
        if (now := time.monotonic()) - self._shown_at < 0.9 * self._seconds:
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
