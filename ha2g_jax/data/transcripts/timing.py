"""Times of words: stretches shared out by letters, gaps filled, overlaps cut, impossible times refused."""

import itertools
import pathlib
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from ha2g_jax.data.transcripts.spelling import num_letters, split_words
from ha2g_jax.errors import UserError
from ha2g_jax.features.text import Word

MAX_SECONDS = 360_000.0  # a hundred hours

# Nobody speaks faster than this.
_MIN_LETTER_SECONDS = 0.03
_MIN_WORD_SECONDS = 1e-3


class Stretch(NamedTuple):
    """A text and when it is spoken; seconds, None where the file gives no times."""

    text: str
    start: float | None
    end: float | None


def spread(texts: Sequence[str], start: float, end: float) -> list[Word]:
    """Words one after the other over a stretch of time, each as long as its share of the letters."""
    if not texts:
        return []
    letters = list(itertools.accumulate(map(num_letters, texts), initial=0))
    edges = [start + (end - start) * count / letters[-1] for count in letters]
    return [Word(text, first, last) for text, first, last in zip(texts, edges[:-1], edges[1:], strict=True)]


def fill_gaps(
    stretches: Sequence[Stretch], start: float | None, end: float | None, *, slack: float = 0.0
) -> list[Stretch]:
    """Texts without times laid into the gaps between their neighbours.

    Rule: a run of them shares the gap by letters. Where the gap, with the slack, has less than 30 ms a letter, or where
    it has no end, the text was hardly spoken there and is left out.

    Args:
        stretches: in the order of the text.
        start, end: seconds that the texts lie between, None where that is not known.
        slack: seconds by which the neighbours' times may be wrong; infinite for words that surely were spoken.

    Returns:
        Those that have times now.
    """
    result: list[Stretch] = []
    runs = [list(run) for _, run in itertools.groupby(stretches, _is_timed)]
    for index, run in enumerate(runs):
        if _is_timed(run[0]):
            result += run
            continue
        before = result[-1].end if result else start
        after = runs[index + 1][0].start if index + 1 < len(runs) else end
        if before is None or after is None:
            continue
        words = [word for stretch in run for word in split_words(stretch.text)]
        if after - before + slack >= _MIN_LETTER_SECONDS * sum(map(num_letters, words)):
            result += [Stretch(*word) for word in spread(words, before, max(before, after))]
    return result


def _is_timed(stretch: Stretch) -> bool:
    return stretch.start is not None and stretch.end is not None


def to_words(stretches: Iterable[Stretch], path: pathlib.Path) -> tuple[Word, ...]:
    """Stretches of a file as words in order of time that do not overlap.

    Rules: the words of a stretch share it by letters; what lies before 0 is cut off; a word ends where the next one
    starts at the latest; words that start together, as those of no length do, share the time up to the next one.

    Args:
        stretches: in any order; those without times are left out.
        path: the file, to name it in a message.

    Returns:
        Words with 0 <= start < end, each at least 1 ms long.

    Raises:
        UserError: a time is not finite or beyond 100 hours, or a stretch ends before it starts.
    """
    words: list[Word] = []
    for text, start, end in stretches:
        if start is None or end is None:
            continue
        # Written so that NaN fails.
        if not (-MAX_SECONDS <= start <= end <= MAX_SECONDS):
            raise UserError(
                f"{path} gives {text[:40]!r} the times {start:g} to {end:g} s; expected seconds, start before end "
                "and below 100 hours: correct the file"
            )
        words += spread(split_words(text), start, end)
    return without_overlap(words)


def without_overlap(words: Iterable[Word]) -> tuple[Word, ...]:
    """Words in order of time, by the rules of `to_words`.

    Args:
        words: finite times, start <= end.
    """
    positive = [word._replace(start=max(0.0, word.start)) for word in words if word.end > 0 or word.start >= 0]
    together: list[list[Word]] = []
    for word in sorted(positive, key=lambda word: word.start):
        if together and word.start - together[-1][0].start < _MIN_WORD_SECONDS:
            together[-1].append(word)
        else:
            together.append([word])
    result: list[Word] = []
    for index, group in enumerate(together):
        texts, start = [word.text for word in group], group[0].start
        shortest = _MIN_LETTER_SECONDS * sum(map(num_letters, texts))
        end = max(word.end for word in group)
        if end - start < _MIN_WORD_SECONDS:
            end = start + shortest
        if index + 1 < len(together):
            end = min(end, together[index + 1][0].start)
        spaced = spread(texts, start, end)
        # More words than the time has milliseconds: the first one stands for all.
        long_enough = [word for word in spaced if word.end - word.start >= _MIN_WORD_SECONDS]
        result += long_enough or [Word(texts[0], start, end)]
    return tuple(result)


def inside(words: Iterable[Word], duration: float) -> tuple[Word, ...]:
    """Words cut to the recording.

    Args:
        words: in any clock that starts with the recording.
        duration: of the recording, in seconds.

    Returns:
        The words that lie at least 1 ms in [0, duration], cut to it.
    """
    cut = (word._replace(start=max(0.0, word.start), end=min(duration, word.end)) for word in words)
    return tuple(word for word in cut if word.end - word.start >= _MIN_WORD_SECONDS)
