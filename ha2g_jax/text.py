"""Words laid on frames, the vocabulary of a training split, and pretrained word vectors (SPEC: inputs, text)."""

import collections
import dataclasses
import functools
import gzip
import io
import math
import pathlib
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from ha2g_jax.errors import UserError

PADDING = 0
UNKNOWN = 1
_SPECIAL = 2


class Word(NamedTuple):
    """A spoken word; times in seconds."""

    text: str
    start: float
    end: float


@dataclasses.dataclass(frozen=True)
class Vocabulary:
    """The words of a training split; index 0 is padding, 1 any word that is not in it.

    Attributes:
        words: the known words, lower case; word i has index i + 2.
    """

    words: tuple[str, ...]

    @classmethod
    def from_words(cls, words: Iterable[str]) -> "Vocabulary":
        """The vocabulary of running words: most frequent first, ties in alphabetical order."""
        counts = collections.Counter(word.lower() for word in words)
        return cls(tuple(sorted(counts, key=lambda word: (-counts[word], word))))

    @functools.cached_property
    def _indices(self) -> dict[str, int]:
        return {word: index for index, word in enumerate(self.words, start=_SPECIAL)}

    def __len__(self) -> int:
        """The size of an embedding table: the words, padding and unknown."""
        return len(self.words) + _SPECIAL

    def encode(self, word: str) -> int:
        """The index of a word, `UNKNOWN` for one that training did not have."""
        return self._indices.get(word.lower(), UNKNOWN)


def words_to_frames(
    words: Sequence[Word], vocabulary: Vocabulary, start_time: float, num_frames: int, fps: float
) -> np.ndarray:
    """Frame-aligned words: each word's index at the frame in which it starts, 0 elsewhere.

    Args:
        words: words in order of time, in the clock of `start_time`.
        vocabulary: gives the indices.
        start_time: of the window, in seconds.
        num_frames: N.
        fps: frames per second.

    Returns:
        (N,) int32. A word that began before the window lies on frame 0 if it is still being spoken there;
        of two words in one frame the later one stays.
    """
    frames = np.zeros(num_frames, np.int32)
    for word in words:
        if word.end <= start_time and word.start < start_time:
            continue
        # A start that lies on a frame border must not fall into the frame before by a rounding error.
        frame = max(0, math.floor((word.start - start_time) * fps + 1e-6))
        if frame < num_frames:
            frames[frame] = vocabulary.encode(word.text)
    return frames


def read_word_vectors(path: str | pathlib.Path, vocabulary: Vocabulary, dim: int) -> np.ndarray:
    """Word vectors of a vocabulary from a fastText, GloVe or word2vec text file or a word2vec binary file.

    A file whose name ends in `.gz` is unpacked while it is read; one whose name before that ends in `.bin` is binary.

    Args:
        path: the file.
        vocabulary: the words to look up.
        dim: the width that the model expects.

    Returns:
        (len(vocabulary), dim) float32. Rows that the file does not have, among them padding and unknown, are drawn
        from N(0, 1 / dim) with a fixed seed.

    Raises:
        UserError: the file is missing, is not one of these formats, or has another width.
    """
    path = pathlib.Path(path)
    if not path.is_file():
        raise UserError(f"no word vectors at {path}; name a fastText, GloVe or word2vec file")
    table = np.random.default_rng(0).normal(0, dim**-0.5, (len(vocabulary), dim)).astype(np.float32)
    is_packed = path.suffix == ".gz"
    is_binary = (path.with_suffix("") if is_packed else path).suffix == ".bin"
    in_vocabulary_spelling: dict[int, bool] = {}
    try:
        with gzip.open(path) if is_packed else path.open("rb") as file:
            rows = _binary_rows(file) if is_binary else _text_rows(file)
            for word, vector in _wanted_rows(rows, vocabulary, dim, path):
                index = vocabulary.encode(word)
                # Files that keep case have "May" and "may": the vocabulary's spelling wins, else the first one.
                if index not in in_vocabulary_spelling or (word == word.lower() and not in_vocabulary_spelling[index]):
                    table[index] = vector
                    in_vocabulary_spelling[index] = word == word.lower()
    except (ValueError, EOFError, OSError) as error:
        raise UserError(
            f"{path} is not a file of word vectors ({error}); "
            "expected fastText, GloVe or word2vec text, or word2vec binary"
        ) from error
    return table


def _wanted_rows(
    rows: Iterator[tuple[str, list[bytes] | np.ndarray]], vocabulary: Vocabulary, dim: int, path: pathlib.Path
) -> Iterator[tuple[str, np.ndarray]]:
    for number, (word, values) in enumerate(rows):
        if number == 0 and len(values) != dim:
            raise UserError(
                f"{path} has vectors of {len(values)} values, the config asks for {dim}; "
                "set model.text.embedding_dim to the file's width or choose another file"
            )
        if vocabulary.encode(word) != UNKNOWN:
            yield word, np.asarray(values[-dim:], np.float32)


def _text_rows(file: io.BufferedIOBase) -> Iterator[tuple[str, list[bytes]]]:
    """Rows `word value value ...`; fastText and word2vec put a line `count dim` before them."""
    width = 0
    for number, line in enumerate(file):
        fields = line.rstrip().split(b" ")
        if number == 0 and len(fields) == 2:
            continue
        width = width or len(fields) - 1
        if len(fields) <= width or width == 0:
            raise ValueError(f"line {number + 1} has {len(fields) - 1} values instead of {width or 'several'}")
        # GloVe has words with spaces in them, such as ". . .".
        word = b" ".join(fields[: len(fields) - width])
        yield word.decode("utf-8", "replace"), fields[len(fields) - width :]


def _binary_rows(file: io.BufferedIOBase) -> Iterator[tuple[str, np.ndarray]]:
    """A line `count dim`, then for each word its name, a space and dim little-endian float32."""
    count, dim = (int(field) for field in file.readline(100).split())
    for _ in range(count):
        name = bytearray()
        while (letter := file.read(1)) != b" ":
            if not letter:
                raise EOFError("it ends early")
            name += letter
        values = file.read(4 * dim)
        if len(values) < 4 * dim:
            raise EOFError("it ends early")
        yield name.decode("utf-8", "replace").lstrip("\n"), np.frombuffer(values, "<f4")
