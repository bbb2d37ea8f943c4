"""Parsers of subtitles, SubRip and WebVTT with a time for every word or line, and of the word tier of a TextGrid."""

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

_WORD_NAMES = ("words", "word", "ort", "ort-mau", "orthography", "transcript", "transcription", "text")
# Words within a tier's name, such as "S1 - words" of the Montreal aligner.
_IS_WORDS = re.compile(r"\b(words?|ort)\b")
_IS_PHONES = re.compile(r"\b(phones?|phon|phonemes?|phonetic|segments?|mau|kan|syllables?|states?)\b")
_SILENCES = {"sil", "sp", "spn", "spl", "_"}
_BRACKETED = re.compile(r"<.*>|\[.*\]|\{.*\}", re.DOTALL)

_ENTRY = re.compile(r"(?:item|intervals|points) ?\[")
# The time of praatio's regular expressions is quadratic in the length of an entry.
_MAX_ENTRY = 1 << 16
_NUM_TIERS = re.compile(r"<exists>\s{1,9}(?:size ?= ?)?([0-9]{1,20})\b")
_NUM_INTERVALS = re.compile(
    r"^[ \t]*intervals ?: ?size ?= ?([0-9]{1,20})[ \t]*$|"
    r'^"IntervalTier"\n"[^"\n]*"\n[^\n]*\n[^\n]*\n([0-9]{1,20})[ \t]*$',
    re.MULTILINE,
)


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


def parse_textgrid(text: str, path: pathlib.Path) -> list[Stretch]:
    """Parse the labels of the word tier of a file at `path`.

    The word tier is the one named words, word, ORT etc.; else one whose name contains such a word; else the interval
    tier with the most labels, except tiers of phones. Empty labels, `sil`, `sp`, `<...>`, `[...]` and `{...}` are
    silence.

    Raises:
        UserError: the text is not a complete TextGrid, or has no tier of words, or the package praatio is missing.
    """
    textgrid_io = require("praatio.utilities.textgrid_io", "import", by=f"{shown(path)} in TextGrid")
    errors = require("praatio.utilities.errors", "import")
    if not text.lstrip().startswith("File type"):
        raise UserError(f"{shown(path)} is not a TextGrid in text form; open it in Praat and save it as text file")
    if "item [" in text and max(map(len, _ENTRY.split(text))) > _MAX_ENTRY:
        raise UserError(f"{shown(path)} has a label of more than {_MAX_ENTRY} characters; expected a TextGrid of words")
    try:
        tiers = textgrid_io.parseTextgridStr(text.strip() + "\n", includeEmptyIntervals=True)["tiers"]
        stretches = [
            (tier["name"], [Stretch(label, float(start), float(end)) for start, end, label in tier["entries"]])
            for tier in tiers
            if tier["class"] == "IntervalTier"
        ]
    except (errors.PraatioException, ValueError, IndexError, KeyError, TypeError) as error:
        raise UserError(
            f"{shown(path)} is a damaged TextGrid ({reason(error)[:80]}); save it again from Praat"
        ) from error
    _check_counts(text, len(tiers), [len(entries) for _, entries in stretches], path)
    return _word_tier([(name, list(filter(_is_speech, entries))) for name, entries in stretches], path)


def _check_counts(text: str, num_tiers: int, num_intervals: list[int], path: pathlib.Path) -> None:
    """Compare the declared counts with those found, because praatio accepts a file that was cut off."""
    declared_tiers = [int(match[1]) for match in _NUM_TIERS.finditer(text)][:1]
    declared = [int(match[1] or match[2]) for match in _NUM_INTERVALS.finditer(text)]
    missing = [(count, found) for count, found in zip(declared, num_intervals) if found < count]
    if missing:
        raise UserError(
            f"{shown(path)} declares {missing[0][0]} intervals but has {missing[0][1]}; export it again, whole"
        )
    if declared_tiers != [num_tiers] or len(declared) != len(num_intervals):
        count = declared_tiers[0] if declared_tiers else "no"
        raise UserError(f"{shown(path)} declares {count} tiers but has {num_tiers} whole ones; export it again")


def _is_speech(stretch: Stretch) -> bool:
    label = stretch.text.strip()
    return bool(label) and label.lower() not in _SILENCES and not _BRACKETED.fullmatch(label)


def _word_tier(tiers: list[tuple[str, list[Stretch]]], path: pathlib.Path) -> list[Stretch]:
    by_name = {name.strip().lower(): entries for name, entries in reversed(tiers) if entries}
    if named := [by_name[name] for name in _WORD_NAMES if name in by_name]:
        return named[0]
    alike = [entries for name, entries in by_name.items() if _IS_WORDS.search(name)]
    others = [entries for name, entries in by_name.items() if not _IS_PHONES.search(name)]
    if not (alike or others):
        names = ", ".join(repr(name[:40]) for name, _ in tiers[:8]) or "none"
        raise UserError(f"{shown(path)} has no interval tier with words (tiers: {names}); name the tier `words`")
    return max(alike or others, key=len)
