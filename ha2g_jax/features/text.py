"""Frame-aligned words, and the vocabulary of a training split."""

import dataclasses
import functools
import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

PADDING = 0
UNKNOWN = 1
_SPECIAL = 2
MAX_PLAIN_WORDS = 32  # including the start and end tokens; 2.3 s of speech have about a dozen words


class Word(NamedTuple):
    """A spoken word, and its start and end in seconds."""

    text: str
    start: float
    end: float


@dataclasses.dataclass(frozen=True)
class Vocabulary:
    """The known words of a training split in lower case; index 0 is padding, 1 any unknown word, i + 2 is word i."""

    words: tuple[str, ...]

    def __repr__(self) -> str:
        return f"Vocabulary({len(self.words)} words)"

    @classmethod
    def from_counts(cls, counts: Mapping[str, int]) -> "Vocabulary":
        """Make a vocabulary from counts of words in lower case: most frequent first, ties in alphabetical order."""
        return cls(tuple(sorted(counts, key=lambda word: (-counts[word], word))))

    @functools.cached_property
    def _indices(self) -> dict[str, int]:
        return {word: index for index, word in enumerate(self.words, start=_SPECIAL)}

    def __len__(self) -> int:
        """Return the number of rows of an embedding table: the words, padding and unknown."""
        return len(self.words) + _SPECIAL

    def encode(self, word: str) -> int:
        """Return the index of a word in any letter case, `UNKNOWN` for one that is not in the vocabulary."""
        return self._indices.get(word.lower(), UNKNOWN)


def words_to_frames(
    words: Sequence[Word], vocabulary: Vocabulary, start_time: float, num_frames: int, fps: float
) -> np.ndarray:
    """Align words, in order of time, with frames: the index of each word at the frame in which it starts, 0 elsewhere.

    The window starts at `start_time` seconds on the clock of the words. A word that is being spoken then is at frame 0;
    of two words in one frame, the later one is kept. Returns (num_frames,) int32.
    """
    frames = np.zeros(num_frames, np.int32)
    for word in words:
        if word.end <= start_time and word.start < start_time:
            continue
        # A start on the border of a frame must not fall into the previous frame because of a rounding error.
        frame = max(0, math.floor((word.start - start_time) * fps + 1e-6))
        if frame < num_frames:
            frames[frame] = vocabulary.encode(word.text)
    return frames


def plain_words(words: Sequence[Word], vocabulary: Vocabulary, start_time: float, duration: float) -> np.ndarray:
    """Return the words in a stretch of speech, without times, as (32,) int32, for a model that reads sentences.

    They are a start token `len(vocabulary)`, at most 30 words, an end token `len(vocabulary) + 1`, and padding.
    """
    inside = [word for word in words if word.end > start_time and word.start < start_time + duration]
    indices = [vocabulary.encode(word.text) for word in inside[: MAX_PLAIN_WORDS - 2]]
    row = np.full(MAX_PLAIN_WORDS, PADDING, np.int32)
    row[: len(indices) + 2] = [len(vocabulary), *indices, len(vocabulary) + 1]
    return row
