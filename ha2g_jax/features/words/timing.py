"""Words of a text and their times: spelling, division of stretches by letters, gaps, overlaps, checks of times."""

import itertools
import pathlib
import re
import unicodedata
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from ha2g_jax.errors import UserError
from ha2g_jax.features.text import Word
from ha2g_jax.files.reading import shown
from ha2g_jax.limits import MAX_WORDS

MAX_SECONDS = 360_000.0  # a hundred hours
# Minimum time per letter; nobody speaks faster.
_MIN_LETTER_SECONDS = 0.03
_MIN_WORD_SECONDS = 1e-3
_ROUNDED_SECONDS = 0.05
_WORD_SECONDS, _LETTER_SECONDS = 0.3, 0.1

_APOSTROPHES = str.maketrans("’‘ʼ＇`", 5 * "'")
_THOUSANDS = re.compile(r"(?<=[0-9]),(?=[0-9]{3}(?![0-9]))")
# Soft hyphens, marks of direction and of byte order.
_UNSEEN = re.compile("[\u00ad\u200e\u200f\u202a-\u202e\u2060\u2066-\u2069\ufeff]")
_NOT_OF_WORDS = re.compile(r"[^a-z0-9']")
# Characters that join letters of Persian and Indian scripts within a word.
_JOINERS = "\u200c\u200d"
_MANY = 100  # marks on one letter


class Stretch(NamedTuple):
    """A text of one or more words, its start and end in seconds, None if the file does not state them, and its speaker,
    "" if the file does not name one.
    """

    text: str
    start: float | None
    end: float | None
    speaker: str = ""


def spread(texts: Sequence[str], start: float, end: float) -> list[Word]:
    """Divide a stretch of time from `start` to `end` among words in proportion to their letters."""
    if not texts:
        return []
    letters = list(itertools.accumulate(map(num_letters, texts), initial=0))
    edges = [start + (end - start) * count / letters[-1] for count in letters]
    return [Word(text, first, last) for text, first, last in zip(texts, edges[:-1], edges[1:], strict=True)]


def with_ends(stretches: Sequence[Stretch], end: float | None = None) -> list[Stretch]:
    """Close stretches with one time: a missing end is the next start, a missing start is the end before or 0.

    After the last start a stretch lasts as long as slow speech, 0.3 s per word and 0.1 s per letter, at most up to
    `end`; if `end` is None, it stays open.
    """
    result: list[Stretch] = []
    following = None
    for one in reversed(stretches):
        if one.start is not None and one.end is None:
            if following is not None and following >= one.start:
                one = one._replace(end=following)
            elif end is not None:
                one = one._replace(end=max(one.start, min(one.start + longest(one.text), end)))
        following = following if one.start is None else one.start
        result.append(one)
    before = 0.0
    for index, one in enumerate(reversed(result)):
        if one.start is None and one.end is not None:
            result[~index] = one._replace(start=min(before, one.end))
        before = before if one.end is None else one.end
    return result[::-1]


def longest(text: str) -> float:
    """Return the time that a text takes in slow speech, in seconds."""
    return sum(_WORD_SECONDS + _LETTER_SECONDS * num_letters(word) for word in split_words(text))


def fill_gaps(
    stretches: Sequence[Stretch], start: float | None, end: float | None, *, slack: float = 0.0
) -> list[Stretch]:
    """Give times to texts without times, in the gaps between their neighbours.

    Texts are those of a file, with tags and labels. The gap is divided among a run of such texts by letters. If the gap
    plus the slack has less than 30 ms per letter, or if the gap has no known end, the text was probably not spoken and
    is left out.

    Args:
        start, end: start and end of the whole text in seconds, None if unknown.
        slack: seconds by which the neighbours' times may be wrong; infinite for words that were certainly spoken.

    Returns:
        The stretches that have times, in order; the last may have a start alone.
    """
    result: list[Stretch] = []
    runs = [list(run) for _, run in itertools.groupby(with_ends(stretches, end), _is_timed)]
    for index, run in enumerate(runs):
        if _is_timed(run[0]):
            result += run
            continue
        before = result[-1].end if result else start
        after = runs[index + 1][0].start if index + 1 < len(runs) else end
        if before is None or after is None:
            continue
        texts = [stretch.text for stretch in run]
        if after - before + slack >= _MIN_LETTER_SECONDS * sum(map(num_letters, texts)):
            timed = spread(texts, before, max(before, after))
            result += [Stretch(*text, stretch.speaker) for text, stretch in zip(timed, run, strict=True)]
    return result


def _is_timed(stretch: Stretch) -> bool:
    return stretch.start is not None


def to_words(stretches: Iterable[Stretch], path: pathlib.Path) -> tuple[Word, ...]:
    """Convert the stretches of a file at `path`, in any order, to words in order of time that do not overlap.

    A stretch is divided among its words by letters. Times before 0 are cut off. A word ends at the latest where the
    next one starts. Words that start at the same time, such as words of no length, divide the time up to the next one.

    Returns:
        Words with 0 <= start < end in seconds, each at least 1 ms long; stretches without times are left out.

    Raises:
        UserError: a time is not finite or beyond 100 hours, a stretch ends before it starts by more than rounding, or
            there are too many words.
    """
    words: list[Word] = []
    for text, start, end, _ in stretches:
        if start is None or end is None:
            continue
        end = start if 0 < start - end < _ROUNDED_SECONDS else end
        # Written so that NaN fails.
        if not (-MAX_SECONDS <= start <= end <= MAX_SECONDS):
            raise UserError(
                f"{shown(path)} gives {text[:40]!r} the times {start:g} to {end:g} s; expected seconds, start before "
                "end and below 100 hours: correct the file"
            )
        texts = split_words(text)
        if len(words) + len(texts) > MAX_WORDS:
            raise UserError(f"{shown(path)} has more than {MAX_WORDS} words; expected a transcript of one recording")
        words += spread(texts, start, end)
    return without_overlap(words)


def without_overlap(words: Iterable[Word]) -> tuple[Word, ...]:
    """Sort words of finite times, start <= end, and remove overlaps, by the rules of `to_words`."""
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
        # If there are more words than milliseconds, only the first word is kept.
        long_enough = [word for word in spaced if word.end - word.start >= _MIN_WORD_SECONDS]
        result += long_enough or [Word(texts[0], start, end)]
    return tuple(result)


def inside(words: Iterable[Word], duration: float) -> tuple[Word, ...]:
    """Return the words of which at least 1 ms lies in [0, duration] seconds, cut to this range."""
    cut = (word._replace(start=max(0.0, word.start), end=min(duration, word.end)) for word in words)
    return tuple(word for word in cut if word.end - word.start >= _MIN_WORD_SECONDS)


def split_words(text: str) -> list[str]:
    """Split a text without brackets and tags into words as the corpus spells them.

    Letters (with their marks), digits and apostrophes within a word are kept, in lower case; everything else separates
    words, so that "twenty-one" is two words. A comma in a number is dropped: "1,000" is "1000".
    """
    if len(text) > _MANY and not text.isascii():
        text = _with_few_marks(text)
    text = unicodedata.normalize("NFC", _UNSEEN.sub("", text)).lower().translate(_APOSTROPHES)
    text = _THOUSANDS.sub("", text)
    if text.isascii():
        text = _NOT_OF_WORDS.sub(" ", text)
    else:
        text = "".join(character if _belongs(character) else " " for character in text)
    words = (word.strip("'" + _JOINERS) for word in text.split())
    return [word for word in words if any(character.isalnum() for character in word)]


def _with_few_marks(text: str) -> str:
    """Cut long runs of marks that belong to one letter, because sorting a run takes quadratic time."""
    marks = "".join(character for character in set(text) if unicodedata.combining(character))
    return re.sub(f"([{marks}]{{{_MANY}}})[{marks}]+", r"\1", text) if marks else text


def _belongs(character: str) -> bool:
    # Vowel signs of Indian scripts are marks, neither letters nor digits.
    return character.isalnum() or character in _JOINERS or character == "'" or unicodedata.category(character)[0] == "M"


def num_letters(word: str) -> int:
    """Count the letters and digits of a word, at least 1; time is divided among words in proportion to them."""
    return max(1, sum(character.isalnum() for character in word))
