"""Words laid on frames, and the vocabulary of a training split (SPEC: inputs, text)."""

import collections
import dataclasses
import functools
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

PADDING = 0
UNKNOWN = 1
_SPECIAL = 2
MAX_PLAIN_WORDS = 32  # with the marks of start and end; 2.3 s of speech hold a dozen words


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
        return cls.from_counts(collections.Counter(word.lower() for word in words))

    @classmethod
    def from_counts(cls, counts: Mapping[str, int]) -> "Vocabulary":
        """The vocabulary of words in lower case that have been counted."""
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


def plain_words(words: Sequence[Word], vocabulary: Vocabulary, start_time: float, duration: float) -> np.ndarray:
    """The words of a stretch of speech without their times, for a model that reads sentences.

    Args:
        words: words in order of time, in the clock of `start_time`.
        vocabulary: gives the indices.
        start_time, duration: of the stretch, in seconds; a word belongs to it if a part of it is heard.

    Returns:
        (32,) int32: a mark of the start, `len(vocabulary)`, the words, a mark of the end, one more, then padding.
        Of more than 30 words the first are taken.
    """
    heard = [word for word in words if word.end > start_time and word.start < start_time + duration]
    indices = [vocabulary.encode(word.text) for word in heard[: MAX_PLAIN_WORDS - 2]]
    row = np.full(MAX_PLAIN_WORDS, PADDING, np.int32)
    row[: len(indices) + 2] = [len(vocabulary), *indices, len(vocabulary) + 1]
    return row
