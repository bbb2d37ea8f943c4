"""Values of the command line, each parsed with a message that argparse prints."""

import argparse
import math

_MAX_DIGITS = 9


def positive(text: str) -> int:
    """Parse a whole number from 1 on."""
    if not text.isdecimal() or not int(text[:_MAX_DIGITS]) >= 1 or len(text) > _MAX_DIGITS:
        raise argparse.ArgumentTypeError(f"{text[:40]!r} is not a whole number from 1 to {'9' * _MAX_DIGITS}")
    return int(text)


def duration(text: str) -> float:
    """Parse a time in seconds or hours, a finite number above 0."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"{text[:40]!r} is not a number above 0")
    return value


def text(value: str) -> str:
    """Parse a text that is stored in a corpus, so that it must be UTF-8."""
    try:
        value.encode()
    except UnicodeEncodeError as error:
        raise argparse.ArgumentTypeError("the text is not UTF-8") from error
    return value
