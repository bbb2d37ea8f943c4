"""Parsers of subtitles: SubRip and WebVTT, with a time for every word or line, and labels of speakers."""

import collections
import html
import itertools
import logging
import pathlib
import re
from collections.abc import Sequence
from typing import NamedTuple

from ha2g_jax.errors import UserError
from ha2g_jax.features.words.textgrid import Tier
from ha2g_jax.features.words.timing import Stretch, longest, split_words, spread
from ha2g_jax.files.reading import shown
from ha2g_jax.limits import MAX_SUBTITLE_LETTERS

_NOTES = re.compile("[♪♫]")
_INLINE_TIME = re.compile(r"<((?:[0-9]{1,4}:)?[0-9]{1,2}:[0-9]{1,2}\.[0-9]{1,3})>")
_TIME = r"((?:[0-9]{1,4}:)?[0-9]{1,2}:[0-9]{1,2}(?:[.,][0-9]{1,9})?)"
_TIMES = re.compile(rf"{_TIME}[ \t]*-->[ \t]*{_TIME}(?![0-9:.,])")
_UNDERLINED = re.compile(r"<u>([^<\n]{0,200})</u>")
_VOICE = re.compile(r"<v(?:\.[^\s>]{0,200})?[ \t]+([^>\n]{1,200})>")
_TURN = re.compile(r"[ \t]*(>>+|[-–—])[ \t]*")
_LABEL = re.compile(r"([^:：\n]{1,60}?)[ \t]*(?::(?=\s|$)|：)")
_MAX_NAME_WORDS = 5
_IDENTIFIER = re.compile(r"(?i:speaker|spk|[a-z]+_?[0-9]+)[\w.]*")
_PARTICLE = re.compile(r"(?i:[-–/|&]|and|of|the|de|da|di|del|der|den|du|van|von|zu|la|le|el|al|bin|ibn|y|e)")
# Words that begin a sentence or a heading before a colon, and are nobody's name.
_NO_NAME = re.compile(
    r"(?i:remember|note|notice|question|answer|warning|caution|example|listen|look|see|think|imagine|consider|first|"
    r"second|third|finally|lastly|next|then|now|today|tomorrow|yesterday|here|there|this|that|these|those|what|why|how|"
    r"when|where|but|and|so|or|yes|no|ok|okay|well|also|again|step|part|chapter|lesson|rule|point|tip|day|number|"
    r"section|act|scene|problem|solution|result|conclusion|fact|truth|reason|idea|important|at|in|on|for|from|by|with|to)"
)
_logger = logging.getLogger(__name__)

_CLOSING = {"{": "}", "[": "]", "(": ")", "<": ">"}
_MAX_INSIDE = 200  # letters


class _Cue(NamedTuple):
    raw: str
    start: float
    end: float


def parse_subtitles(text: str, path: pathlib.Path) -> list[Tier]:
    """Parse SubRip or WebVTT, of a file at `path`: a stretch per cue, speaker in it, or word if it has times of words.

    A cue with unreadable times is left out, with a warning in the log.

    Raises:
        UserError: no cue has readable times, or the file is too large.
    """
    if len(text) > MAX_SUBTITLE_LETTERS:
        found = f"{len(text)} characters; expected at most {MAX_SUBTITLE_LETTERS}"
        raise UserError(f"{shown(path)} has {found}: cut the file")
    is_vtt = text.lstrip().startswith("WEBVTT")
    lines = [line.strip(" \t") or line[:1] for line in text.split("\n")]
    borders = [number for number, line in enumerate(lines) if "-->" in line and line[0].isdigit()]
    cues = []
    for border, after in itertools.pairwise([*borders, len(lines) + 1]):
        body = lines[border + 1 : after]
        if is_vtt:
            body = list(itertools.takewhile(bool, body))  # a line of one blank, as YouTube writes, ends no cue
        elif after < len(lines) and body and body[-1].isdecimal():
            del body[-1]  # the number of the next cue
        if match := _TIMES.match(lines[border]):
            cues.append(_Cue("\n".join(body).strip(), _to_seconds(match[1]), _to_seconds(match[2])))
    if not cues:
        raise UserError(f"{shown(path)} has no subtitles with times; export it again as SubRip or WebVTT")
    if len(cues) < len(borders):
        num_unread = len(borders) - len(cues)
        _logger.warning("%s: %d of %d cues cannot be read; left out", shown(path), num_unread, len(borders))
    return _stretches(cues)


def _stretches(cues: Sequence[_Cue]) -> list[Tier]:
    labels = _labels([_lines(cue.raw) for cue in cues])
    if any(_INLINE_TIME.search(cue.raw) for cue in cues):
        return [Tier("", _timed_words(cues, labels))]
    turns = [_turns(cue.raw, labels) for cue in cues]
    texts = ["\n".join(text for _, text in of_cue) for of_cue in turns]
    underlined = [_UNDERLINED.findall(cue.raw) for cue in cues]
    # Whisper's --highlight_words shows the whole line once for each word, with that word underlined.
    repeated = sum(
        bool(words) and text in texts[i + 1 : i + 3] for i, (text, words) in enumerate(zip(texts, underlined))
    )
    if 2 * repeated > sum(map(bool, underlined)):
        turns = [[(None, " ".join(words))] for words in underlined]
    stretches: list[Stretch] = []
    speaker = ""
    for cue, of_cue in zip(cues, turns, strict=True):
        words: list[tuple[str, str]] = []
        for name, text in of_cue:
            speaker = speaker if name is None else name
            words += [(word, speaker) for word in split_words(text)]
        timed = spread([word for word, _ in words], cue.start, cue.end)
        stretches += [Stretch(*word, of_word) for word, (_, of_word) in zip(timed, words, strict=True)]
    return [Tier("", stretches)]


def _lines(raw: str) -> list[str]:
    """Return the lines of a cue without tags and what is shown but not spoken, such as {\\\\an8} and notes."""
    text = html.unescape(without_brackets(raw, "<", ""))
    return _NOTES.sub(" ", without_brackets(text, "{", " ")).split("\n")


def _label(line: str) -> tuple[str, str, bool] | None:
    """Return the name before a colon at the start of a line, what follows it, and whether its form alone says that it
    is the label of a speaker; None if it cannot be one.
    """
    match = _LABEL.match(line)
    if match is None:
        return None
    written, rest = match[1].strip(), line[match.end() :]
    name = " ".join(without_brackets(written, "[(", " ").split())
    if not name:
        return written.strip("[]() "), rest, True
    words = name.split()
    if _IDENTIFIER.fullmatch(words[0]) and len(words) <= 2:
        return name, rest, True
    # Scripts without capitals have no lower case either.
    is_name = (
        all((word[0].isalnum() and not word[0].islower()) or _PARTICLE.fullmatch(word) for word in words)
        and words[0][0].isalpha()
    )
    if not is_name or len(words) > _MAX_NAME_WORDS or _NO_NAME.fullmatch(words[0].rstrip(",")):
        return None
    # In a file of capitals they say nothing.
    is_sure = not rest.isupper() if name.isupper() else len(words) > 1 and name.upper() != name.lower()
    return name, rest, is_sure


def _labels(cues: Sequence[list[str]]) -> set[str]:
    """Return the labels of speakers in cues, given as lines.

    A label stands before a colon at the start of a cue or after `>>` or `-`. It is a name in brackets or capitals, such
    as `[X]:` and `JOHN:`, or with a number, such as `Speaker 1:`, or up to five words that all begin with capitals,
    such as `Jordan Rivers:`. One word alone, such as `Jordan:`, may be speech: it is a label if it begins two cues or
    more, or if half of the cues begin so and it has a capital after it or others beside it that are labels. Words that
    introduce a sentence, such as `Remember:`, never are.
    """
    counts: collections.Counter[str] = collections.Counter()
    sure, before_capitals = set(), set()
    for lines in cues:
        for number, line in enumerate(lines):
            turn = _TURN.match(line)
            label = _label(line[turn.end() if turn else 0 :].strip())
            if label is None or (number and not turn and not _label(lines[0].strip())):
                continue
            name, rest, is_sure = label
            counts[name] += 1
            if is_sure:
                sure.add(name)
            if not rest.strip()[:1].islower():
                before_capitals.add(name)
    sure |= {name for name, count in counts.items() if count > 1}
    if 2 * counts.total() < len(cues):
        return sure
    return {*counts} if sure else before_capitals


def _turns(raw: str, labels: set[str]) -> list[tuple[str | None, str]]:
    """Return the speakers and the spoken texts of a cue: the name of a voice or label, empty after a sign of another
    speaker without a name, None if the speaker is the one before.
    """
    turns: list[tuple[str | None, str]] = []
    before, *voices = _VOICE.split(raw)
    for name, text in [(None, before), *zip(voices[::2], voices[1::2], strict=True)]:
        for line in _lines(text):
            speaker = html.unescape(name).strip() if name else None
            if turn := _TURN.match(line):
                line, speaker = line[turn.end() :], speaker or ""
            label = _label(line.strip())
            if label and (label[0] in labels or (label[0].isupper() and label[2])):
                speaker, line = speaker or label[0], label[1]
            # Sounds, such as [music] and (laughs).
            turns.append((speaker, without_brackets(line, "[(", " ")))
    return turns


def _spoken(raw: str, labels: set[str]) -> str:
    return "\n".join(text for _, text in _turns(raw, labels))


def _timed_words(cues: Sequence[_Cue], labels: set[str]) -> list[Stretch]:
    """Return the words of cues such as `so<00:00:00.320><c> today</c>`.

    YouTube shows every line twice, first while it is spoken and then above the next one, so the last lines of the
    previous cue are not read again. Only starts of words are written; a word before a pause does not last until its
    end.
    """
    stretches: list[Stretch] = []
    shown: list[str] = []
    speaker = ""
    for cue in cues:
        lines = [line for line in cue.raw.split("\n") if _spoken(line, labels).strip()]
        plain = [_spoken(line, labels).strip() for line in lines]
        known = next((count for count in range(len(plain), 0, -1) if plain[:count] == shown[-count:]), 0)
        shown = plain
        # [text, time, text, time, text ...]
        parts = _INLINE_TIME.split("\n".join(lines[known:]))
        times = [cue.start, *map(_to_seconds, parts[1::2]), cue.end]
        for part, start, end in zip(parts[::2], times[:-1], times[1:], strict=True):
            turns = _turns(part, labels)
            speaker = next((name for name, _ in reversed(turns) if name is not None), speaker)
            if words := [word for _, text in turns for word in split_words(text)]:
                text = " ".join(words)
                stretches.append(Stretch(text, start, min(end, start + longest(text)), speaker))
    return stretches


def _to_seconds(time: str) -> float:
    *hours, minutes, seconds = time.replace(",", ".").split(":")
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
