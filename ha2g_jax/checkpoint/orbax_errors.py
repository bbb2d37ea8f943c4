"""What Orbax says when a checkpoint cannot be written or read, made short."""

import functools
import logging
import os
import re
import sys
from typing import Any


def reason(error: Exception) -> str:
    """The cause of an error in a few words: TensorStore gives it among paths and line numbers."""
    if match := re.search(r"os_error_code='(\d+)'", str(error)):
        return os.strerror(int(match[1]))
    text = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return " ".join(text.split())[:200] or type(error).__name__


@functools.cache
def hide_echoes() -> None:
    """Keeps what Orbax raises from being printed as well, with tracebacks, and its warnings about being waited for."""

    def is_news(record: logging.LogRecord) -> bool:
        is_echo = record.exc_info or record.levelno <= logging.WARNING
        return not (is_echo and "orbax" in record.pathname + record.getMessage())

    for name in ("absl", "asyncio"):
        logging.getLogger(name).addFilter(is_news)
    previous = sys.unraisablehook

    def hook(unraisable: Any) -> None:
        if str(unraisable.exc_value) != "Event loop is closed":  # where writes are cut short
            previous(unraisable)

    sys.unraisablehook = hook
