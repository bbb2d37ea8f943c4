"""Reader of the numbers of a BVH file, in blocks, so that memory depends on the size of the file alone."""

import pathlib
from collections.abc import Iterator, Sequence
from typing import TextIO

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import shown

_BLOCK = 1 << 20  # letters that are parsed at once
_MAX_NUMBER = 1 << 16  # letters of a number
_MAX_SHOWN = 40  # letters of a word in a message
_MAX_VALUE = 1e7  # value of a channel: ten kilometres in millimetres


def read_values(path: pathlib.Path, file: TextIO, begin: str, frames: int, names: Sequence[str]) -> np.ndarray:
    """Read the values of all channels in all frames; values beyond them are ignored.

    Args:
        path: path of the file, to name it in an error message.
        file: the open file, at the end of `begin`.
        begin: text of the motion that was read already.
        frames: number of frames.
        names: name of each channel, to name it in an error message.

    Returns:
        (frames, channels) values.

    Raises:
        UserError: the file has fewer values, or one that is not a number or too large.
    """
    wanted, found = frames * len(names), 0
    parts: list[np.ndarray] = []
    for block in _blocks(path, file, begin):
        words = block[: wanted - found]
        parts.append(_numbers(path, words, found, names))
        found += len(words)
        if found == wanted:
            return np.concatenate(parts).reshape(frames, len(names))
    raise UserError(
        f"{shown(path)} is cut off: it holds {found // len(names)} whole frames of {len(names)} values, but its "
        f"header declares {frames}; export it again"
    )


def _blocks(path: pathlib.Path, file: TextIO, begin: str) -> Iterator[list[str]]:
    """Yield the words of the motion, some thousands at a time."""
    rest = f"{begin} "
    while block := file.read(_BLOCK):
        text = rest + block
        words = text.split()
        # The last word may continue in the next block.
        rest = words.pop() if words and not text[-1].isspace() else ""
        if len(rest) > _MAX_NUMBER:
            raise UserError(
                f"{shown(path)} has a word of more than {_MAX_NUMBER} characters, expected numbers; export it again"
            )
        yield words
    yield rest.split()


def _numbers(path: pathlib.Path, words: list[str], found: int, names: Sequence[str]) -> np.ndarray:
    try:
        # Word by word: an array of text would give each word the space of the longest.
        values = np.fromiter(map(float, words), float, len(words))
    except ValueError:
        values = np.array([to_number(word) for word in words], float)  # None becomes NaN
    is_bad = ~(np.abs(values) <= _MAX_VALUE)
    if is_bad.any():
        index = int(np.argmax(is_bad))
        frame, column = divmod(found + index, len(names))
        raise UserError(
            f"{shown(path)}: {names[column]} in frame {frame + 1} is {short(words[index])}, expected a number; "
            "export the motion again"
        )
    return values


def to_number(word: str) -> float | None:
    """Parse a number; None if the word is none, or not finite, or too large for a motion."""
    try:
        value = float(word)
    except ValueError:
        return None
    return value if abs(value) <= _MAX_VALUE else None


def short(text: str) -> str:
    """Return a word of the file in quotes, cut if it is long."""
    return repr(text if len(text) <= _MAX_SHOWN else text[:_MAX_SHOWN] + "...")
