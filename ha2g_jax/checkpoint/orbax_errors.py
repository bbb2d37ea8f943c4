"""Shorten the errors and warnings of Orbax about checkpoints that cannot be written or read."""

import functools
import logging
import os
import re
import sys
from typing import Any


def reason(error: Exception) -> str:
    """Return the cause of an error in a few words, which TensorStore reports among paths and line numbers.

    Args:
        error: exception that Orbax raised.
    """
    if match := re.search(r"os_error_code='(\d+)'", str(error)):
        return os.strerror(int(match[1]))
    text = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return " ".join(text.split())[:200] or type(error).__name__


@functools.cache
def hide_echoes() -> None:
    """Keep Orbax from printing the exceptions that it raises, and its warnings that it is being waited for."""

    def is_news(record: logging.LogRecord) -> bool:
        is_echo = record.exc_info or record.levelno <= logging.WARNING
        return not (is_echo and "orbax" in record.pathname + record.getMessage())

    for name in ("absl", "asyncio"):
        logging.getLogger(name).addFilter(is_news)
    previous = sys.unraisablehook

    def hook(unraisable: Any) -> None:
        if str(unraisable.exc_value) != "Event loop is closed":  # raised when a write is interrupted
            previous(unraisable)

    sys.unraisablehook = hook
