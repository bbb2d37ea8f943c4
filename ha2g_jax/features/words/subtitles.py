"""Parser of subtitles: SubRip and WebVTT, including those of YouTube and Whisper with a time for every word."""

import html
import itertools
import logging
import pathlib
import re
from collections.abc import Sequence
from typing import NamedTuple

from ha2g_jax.errors import UserError, require
from ha2g_jax.features.words.timing import Stretch, num_letters, split_words
from ha2g_jax.files.reading import reason, shown
from ha2g_jax.limits import MAX_CUE_LINES, MAX_SUBTITLE_LETTERS

_NOTES = re.compile("[♪♫]")
_INLINE_TIME = re.compile(r"<((?:[0-9]{1,4}:)?[0-9]{1,2}:[0-9]{1,2}\.[0-9]{1,3})>")
_UNDERLINED = re.compile(r"<u>([^<\n]{0,200})</u>")
# "JOHN:", ">> DR. WHO:", "Speaker 1:", "- ".
_SPEAKER = re.compile(
    r"^[ \t]*(?:>>+|[-–—])?[ \t]*(?:(?:[A-Z][A-Z0-9_.' -]{1,29}|(?i:speaker)[ _]?[0-9A-Z]{1,3}):(?=\s|$))?",
    re.MULTILINE,
)
_BLANKS = re.compile(r"[^\S\n]+")
_LONG_NUMBER = re.compile(r"[0-9]{30}")
# WebVTT has only the start of a word; without this limit, a word before a pause would last until its end.
_WORD_SECONDS, _LETTER_SECONDS = 0.3, 0.1
_logger = logging.getLogger(__name__)

_CLOSING = {"{": "}", "[": "]", "(": ")", "<": ">"}
_MAX_INSIDE = 200  # letters


class _Cue(NamedTuple):
    raw: str
    start: float
    end: float


def parse_srt(text: str, path: pathlib.Path) -> list[Stretch]:
    """Parse SubRip, of a file at `path`: one stretch per subtitle, or one per word if it has times of words.

    Raises:
        UserError: the text is not SubRip, or the package srt is missing.
    """
    srt = require("srt", "import", by=f"{shown(path)} in SubRip")
    if _LONG_NUMBER.search(text):
        raise UserError(f"{shown(path)} has a number of more than 30 digits; expected subtitles")
    # The library takes quadratic time for runs of blanks.
    lines = [_BLANKS.sub(" ", line).strip() for line in text.strip().split("\n")]
    kept = [line for line, before in zip(lines, ["", *lines[:-1]], strict=True) if line or before]
    _check_cues(kept, "-->", path)
    try:
        cues = list(srt.parse("\n".join(kept) + "\n"))
    except (srt.SRTParseError, srt.TimestampParseError, ValueError, OverflowError) as error:
        raise UserError(
            f"{shown(path)} is not valid SubRip ({reason(error)[:80]}); export the subtitles again"
        ) from error
    return _stretches([_Cue(cue.content, cue.start.total_seconds(), cue.end.total_seconds()) for cue in cues])


def parse_vtt(text: str, path: pathlib.Path) -> list[Stretch]:
    """Parse WebVTT, of a file at `path`: one stretch per cue, or one per word if it has times of words.

    A cue with unreadable times is left out, with a warning in the log.

    Raises:
        UserError: the text is not WebVTT, or the package webvtt-py is missing.
    """
    webvtt = require("webvtt", "import", by=f"{shown(path)} in WebVTT", package="webvtt-py")
    _check_cues(text.split("\n"), "", path)
    try:
        captions = webvtt.from_string(text.lstrip()).captions
    except (webvtt.errors.MalformedFileError, webvtt.errors.MalformedCaptionError, ValueError) as error:
        raise UserError(f"{shown(path)} is not WebVTT ({reason(error)[:80]}); export the subtitles again") from error
    num_arrows = sum("-->" in line for line in text.split("\n"))
    if num_arrows > len(captions):
        _logger.warning(
            "%s: %d of %d cues cannot be read; left out", shown(path), num_arrows - len(captions), num_arrows
        )
    return _stretches(
        [
            _Cue(one.raw_text, one.start_time.in_milliseconds() / 1000, one.end_time.in_milliseconds() / 1000)
            for one in captions
        ]
    )


def _check_cues(lines: Sequence[str], border: str, path: pathlib.Path) -> None:
    """Check the numbers of letters and of lines in a cue, for which the libraries take quadratic time.

    A cue begins with a line that contains `border` (SRT, whose cues may have empty lines) or after an empty one (VTT).
    """
    total = sum(map(len, lines)) + len(lines)
    if total > MAX_SUBTITLE_LETTERS:
        raise UserError(f"{shown(path)} has {total} characters; expected at most {MAX_SUBTITLE_LETTERS}: cut the file")
    places = [-1, *(i for i, line in enumerate(lines) if (border in line if border else not line)), len(lines)]
    longest = max(after - before for before, after in itertools.pairwise(places)) - 1
    if longest > MAX_CUE_LINES:
        raise UserError(
            f"{shown(path)} has a subtitle of {longest} lines; expected at most {MAX_CUE_LINES}: export it again"
        )


def _stretches(cues: Sequence[_Cue]) -> list[Stretch]:
    if any(_INLINE_TIME.search(cue.raw) for cue in cues):
        return _timed_words(cues)
    texts = [_spoken(cue.raw) for cue in cues]
    underlined = [_UNDERLINED.findall(cue.raw) for cue in cues]
    # Whisper's --highlight_words shows the whole line once for each word, with that word underlined.
    repeated = sum(
        bool(words) and text in texts[i + 1 : i + 3] for i, (text, words) in enumerate(zip(texts, underlined))
    )
    if 2 * repeated > sum(map(bool, underlined)):
        return [Stretch(" ".join(words), cue.start, cue.end) for words, cue in zip(underlined, cues, strict=True)]
    return [Stretch(text, cue.start, cue.end) for text, cue in zip(texts, cues, strict=True)]


def _spoken(raw: str) -> str:
    """Remove tags, sounds in brackets and labels of speakers from a cue."""
    text = html.unescape(without_brackets(raw, "<", ""))
    # Text that is shown but not spoken: {\\an8}, [music], (laughs), notes.
    return _SPEAKER.sub("", _NOTES.sub(" ", without_brackets(text, "{[(", " ")))


def _timed_words(cues: Sequence[_Cue]) -> list[Stretch]:
    """Return the words of cues such as `so<00:00:00.320><c> today</c>`.

    YouTube shows every line twice, first while it is spoken and then above the next one, so the last lines of the
    previous cue are not read again.
    """
    stretches: list[Stretch] = []
    shown: list[str] = []
    for cue in cues:
        lines = [line for line in cue.raw.split("\n") if _spoken(line).strip()]
        plain = [_spoken(line).strip() for line in lines]
        known = next((count for count in range(len(plain), 0, -1) if plain[:count] == shown[-count:]), 0)
        shown = plain
        # [text, time, text, time, text ...]
        parts = _INLINE_TIME.split("\n".join(lines[known:]))
        times = [cue.start, *map(_to_seconds, parts[1::2]), cue.end]
        for part, start, end in zip(parts[::2], times[:-1], times[1:], strict=True):
            words = split_words(_spoken(part))
            longest = sum(_WORD_SECONDS + _LETTER_SECONDS * num_letters(word) for word in words)
            if words:
                stretches.append(Stretch(" ".join(words), start, min(end, start + longest)))
    return stretches


def _to_seconds(time: str) -> float:
    *hours, minutes, seconds = time.split(":")
    return 3600 * int(hours[0] if hours else 0) + 60 * int(minutes) + float(seconds)


def without_brackets(text: str, openings: str, instead: str) -> str:
    """Replace each bracket that begins with one of `openings`, some of `{[(<`, with at most 200 letters on one line.

    A regular expression would try 200 letters for each opening bracket, which takes minutes for a file full of them.
    """
    kept, position = [], 0
    for opening in re.finditer(f"[{re.escape(openings)}]", text):
        start = opening.start()
        if start < position:
            continue
        end = text.find(_CLOSING[opening[0]], start + 1, start + _MAX_INSIDE + 2)
        if end < 0 or text.find("\n", start, end) >= 0:
            continue
        kept.append(text[position:start])
        position = end + 1
    return instead.join([*kept, text[position:]])
