"""Reader of the pretrained word vectors of a vocabulary from fastText, GloVe and word2vec files."""

import gzip
import io
import itertools
import mmap
import os
import pathlib
import struct
import zlib
from collections.abc import Iterator
from typing import NamedTuple, TypeVar

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.features.text import UNKNOWN, Vocabulary
from ha2g_jax.files.reading import reading, reason, shown
from ha2g_jax.limits import MAX_UNPACKED_RATIO

_ZIP = b"PK\x03\x04"
_MAX_LINE = 1 << 20  # bytes in a line of a text file
_MAX_NAME = 1 << 16
_SMALL = 1 << 24  # bytes that any compressed file may unpack to

# fastText's own format, little-endian throughout.
_FASTTEXT = struct.pack("<i", 793712314)
_ARGUMENTS = struct.Struct("<4x13id")
_DICTIONARY = struct.Struct("<3i2q")
_ENTRY_BYTES = 9  # size of count and kind, which follow a word
_MATRIX = struct.Struct("<?2q")
_SUPERVISED = 3
_END_OF_SENTENCE = b"</s>"

_Value = TypeVar("_Value")


def read_word_vectors(path: str | os.PathLike, vocabulary: Vocabulary, dim: int) -> np.ndarray:
    """Read the word vectors of a vocabulary: fastText `.vec` and `.bin`, GloVe and word2vec text, word2vec `.bin`.

    Text and word2vec files are read as a stream, through gzip if the name ends in `.gz`; of a fastText `.bin` only the
    needed rows of the matrix are read. A fastText `.bin` has a vector for every word, which for an unknown word is
    computed from its character n-grams (Bojanowski et al. 2017).

    Returns:
        (len(vocabulary), dim) float32. Rows that the file does not have, including padding and unknown, are drawn from
        N(0, 1 / dim) with a fixed seed.

    Raises:
        UserError: the file is missing, is not one of these formats, is damaged, has another width, or knows none of the
            words.
    """
    path = pathlib.Path(path)
    with reading(path, "a file of word vectors"):
        is_file = path.is_file()
    if not is_file:
        raise UserError(f"no word vectors at {shown(path)}; give a fastText, GloVe or word2vec file")
    table = np.random.default_rng(0).normal(0, dim**-0.5, (len(vocabulary), dim)).astype(np.float32)
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # values that are not finite are refused below
            rows = _rows(path, vocabulary, dim)
    except (ValueError, ArithmeticError, EOFError, OSError, zlib.error, struct.error) as error:
        raise UserError(
            f"{shown(path)} is not a file of word vectors ({reason(error)}); "
            "expected fastText, GloVe or word2vec text, or fastText or word2vec binary"
        ) from error
    if not rows and vocabulary.words:
        raise UserError(
            f"{shown(path)} has none of the {len(vocabulary.words)} words of the vocabulary; choose vectors of its "
            "language"
        )
    for index, (name, vector) in rows.items():
        table[index] = vector
        if not np.isfinite(vector).all():
            raise UserError(f"{shown(path)} has a vector for {name!r} that is not finite; choose another file")
    return table


def _rows(path: pathlib.Path, vocabulary: Vocabulary, dim: int) -> dict[int, tuple[str, np.ndarray]]:
    """Return the name in the file and the vector (dim,) by index in the vocabulary."""
    is_packed = path.suffix.lower() == ".gz"
    is_binary = (path.with_suffix("") if is_packed else path).suffix.lower() == ".bin"
    with gzip.open(path) if is_packed else path.open("rb") as file:
        head = file.peek(4)[:4]
        if not head:
            raise ValueError("it is empty")
        if head == _ZIP or (is_packed and head == _FASTTEXT):
            raise UserError(f"{shown(path)} is packed and cannot be read in place; unpack it (unzip, gunzip) first")
        if head == _FASTTEXT:
            return _fasttext_rows(path, vocabulary, dim)
        reader = _word2vec_rows if is_binary else _text_rows
        source = _Unpacked(file, _SMALL + MAX_UNPACKED_RATIO * path.stat().st_size) if is_packed else file
        return _best_spellings(reader(source, vocabulary, path, dim), vocabulary)


class _Unpacked:
    """A file from which at most `most` bytes are read, because a small compressed file may unpack to any size."""

    def __init__(self, file: io.BufferedIOBase, most: int):
        self._file, self._left = file, most

    def read(self, size: int) -> bytes:
        return self._count(self._file.read(size))

    def readline(self, size: int) -> bytes:
        return self._count(self._file.readline(size))

    def _count(self, content: bytes) -> bytes:
        self._left -= len(content)
        if self._left < 0:
            raise ValueError(f"it unpacks to more than {MAX_UNPACKED_RATIO} times its size")
        return content


def _best_spellings(rows: Iterator[tuple[str, _Value]], vocabulary: Vocabulary) -> dict[int, tuple[str, _Value]]:
    """Return the name and the value of the best row for each index in the vocabulary."""
    best: dict[int, tuple[str, _Value]] = {}
    for name, value in rows:
        index = vocabulary.encode(name)
        # Case-sensitive files have "May" and "may": the vocabulary's spelling is preferred, or else the first one.
        if index != UNKNOWN and (index not in best or (name == name.lower() and best[index][0] != name)):
            best[index] = name, value
    return best


def _check_width(path: pathlib.Path, found: int, dim: int) -> None:
    if found != dim:
        raise UserError(
            f"{shown(path)} has vectors of {found} values, but the config expects {dim}; "
            "set model.text.embedding_dim to the file's width or choose another file"
        )


def _text_rows(
    file: io.BufferedIOBase | _Unpacked, vocabulary: Vocabulary, path: pathlib.Path, dim: int
) -> Iterator[tuple[str, np.ndarray]]:
    """Yield rows `word value value ...`; in fastText and word2vec files a line `count dim` comes before them."""
    is_first = True
    for number, line in enumerate(iter(lambda: file.readline(_MAX_LINE), b""), start=1):
        line = line.rstrip()
        num_values = line.count(b" ")
        if number == 1 and num_values == 1:
            _check_width(path, int(line.split(b" ")[1]), dim)
            continue
        if is_first:
            _check_width(path, num_values, dim)
        is_first = False
        if num_values < dim:
            raise ValueError(f"line {number} has {num_values} values instead of {dim}")
        # GloVe has words that contain spaces, such as ". . .".
        name = line.split(b" ", 1)[0] if num_values == dim else line.rsplit(b" ", dim)[0]
        word = name.decode("utf-8", "replace")
        if vocabulary.encode(word) != UNKNOWN:
            yield word, np.array(line.rsplit(b" ", dim)[1:], np.float32)


def _word2vec_rows(
    file: io.BufferedIOBase | _Unpacked, vocabulary: Vocabulary, path: pathlib.Path, dim: int
) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the words of a file with a line `count dim`, then for each word its name, a space and dim little-endian
    float32."""
    count, width = (int(field) for field in file.readline(100).split())
    _check_width(path, width, dim)
    if count < 0:
        raise ValueError(f"a count of {count} words")
    for _ in range(count):
        name = bytearray()
        while (letter := file.read(1)) != b" ":
            if not letter or len(name) > _MAX_NAME:
                raise EOFError("it ends early" if not letter else "a word without end")
            name += letter
        values = file.read(4 * dim)
        if len(values) < 4 * dim:
            raise EOFError("it ends early")
        word = name.decode("utf-8", "replace").lstrip("\n")
        if vocabulary.encode(word) != UNKNOWN:
            yield word, np.frombuffer(values, "<f4")


class _Subwords(NamedTuple):
    """Shortest and longest character n-grams of a word, and the number of rows that they are hashed to."""

    shortest: int
    longest: int
    num_buckets: int


def _fasttext_rows(path: pathlib.Path, vocabulary: Vocabulary, dim: int) -> dict[int, tuple[str, np.ndarray]]:
    """Return the vectors of a fastText model: the mean of a word's own row and the rows of its n-grams."""
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        version, width, *_, model, num_buckets, shortest, longest, _, _ = _ARGUMENTS.unpack_from(data)
        if version not in (11, 12):
            raise ValueError(f"fastText format {version}, expected 11 or 12")
        _check_width(path, width, dim)
        subwords = _Subwords(shortest, 0 if version == 11 and model == _SUPERVISED else longest, num_buckets)
        size, num_words, num_labels, _, num_pruned = _DICTIONARY.unpack_from(data, _ARGUMENTS.size)
        if num_words < 0 or size != num_words + num_labels or num_buckets < (subwords.longest > 0):
            raise ValueError(f"a dictionary of {size} entries, {num_words} words and {num_buckets} buckets")
        own_rows, end = _fasttext_dictionary(data, size, num_words, vocabulary)
        is_quantised, num_rows, num_columns = _MATRIX.unpack_from(data, end)
        start = end + _MATRIX.size
        if is_quantised or num_pruned >= 0:
            raise UserError(
                f"{shown(path)} is a quantised fastText model (.ftz), which is not supported; use the full .bin"
            )
        if (num_rows, num_columns) != (num_words + num_buckets, dim) or start + 4 * num_rows * dim > len(data):
            raise ValueError(f"its matrix of {num_rows} x {num_columns} is cut off, or does not match its words")
    vectors: dict[int, tuple[str, np.ndarray]] = {}
    if num_rows:
        matrix = np.memmap(path, "<f4", "r", offset=start, shape=(num_rows, dim))
        for word in vocabulary.words:
            name, own = own_rows.get(vocabulary.encode(word), (word, None))
            rows = [num_words + bucket for bucket in _subword_buckets(name.encode(), subwords)]
            rows = rows if own is None else [own, *rows]
            if rows:
                vectors[vocabulary.encode(word)] = name, np.asarray(matrix[rows], np.float32).mean(axis=0)
    return vectors


def _fasttext_dictionary(
    data: mmap.mmap, size: int, num_words: int, vocabulary: Vocabulary
) -> tuple[dict[int, tuple[str, int]], int]:
    """Return the name and row of each word of a dictionary by index in the vocabulary, and the dictionary's end."""
    wanted = []
    position = _ARGUMENTS.size + _DICTIONARY.size
    for row in range(size):
        end = data.find(b"\0", position, position + _MAX_NAME)
        if end < 0:
            raise EOFError("it ends early, or has a word without end")
        word = data[position:end].decode("utf-8", "replace")
        if row < num_words and vocabulary.encode(word) != UNKNOWN:
            wanted.append((word, row))
        position = end + 1 + _ENTRY_BYTES
    return _best_spellings(iter(wanted), vocabulary), position


def _subword_buckets(name: bytes, subwords: _Subwords) -> list[int]:
    """Return the buckets of a word's character n-grams, by the FNV-1a hash of signed bytes."""
    if name == _END_OF_SENTENCE:
        return []
    word = b"<" + name + b">"
    starts = [place for place, byte in enumerate(word) if byte & 0xC0 != 0x80]
    characters = [word[start:end] for start, end in itertools.pairwise([*starts, len(word)])]
    buckets = []
    for first in range(len(characters)):
        value = 2166136261
        for last in range(first, min(first + subwords.longest, len(characters))):
            for byte in characters[last]:
                value = (value ^ (byte | (0xFFFFFF00 if byte & 0x80 else 0))) * 16777619 & 0xFFFFFFFF
            # The brackets alone are not n-grams.
            is_bracket = first == last and first in (0, len(characters) - 1)
            if last - first + 1 >= subwords.shortest and not is_bracket:
                buckets.append(value % subwords.num_buckets)
    return buckets
