"""Parsers of subtitles: SubRip and WebVTT, with a time for every word or cue."""

import itertools
import logging
import pathlib
import re
from collections.abc import Sequence

from ha2g_jax.errors import UserError
from ha2g_jax.features.words.labels import find_labels, to_lines, turns
from ha2g_jax.features.words.textgrid import Tier
from ha2g_jax.features.words.timing import Stretch, longest, split_words
from ha2g_jax.files.reading import shown
from ha2g_jax.limits import MAX_SUBTITLE_LETTERS

_INLINE_TIME = re.compile(r"<((?:[0-9]{1,4}:)?[0-9]{1,2}:[0-9]{1,2}\.[0-9]{1,3})>")
_TIME = r"(-?(?:[0-9]{1,4}:)?[0-9]{1,2}:[0-9]{1,2}(?:[.,][0-9]{1,9})?)"
_TIMES = re.compile(rf"{_TIME}[ \t]*-->[ \t]*{_TIME}(?![0-9:.,])")
_UNDERLINED = re.compile(r"<u>([^<\n]{0,200})</u>")
_PAUSE = 0.5  # seconds after which a repeated line is spoken again, not only shown again
_logger = logging.getLogger(__name__)


def parse_subtitles(text: str, path: pathlib.Path) -> list[Tier]:
    """Parse SubRip or WebVTT, of a file at `path`: a stretch per cue, or per word if words have times.

    A cue with unreadable times is left out, with a warning in the log.

    Raises:
        UserError: no cue has readable times, or the file is too large.
    """
    if len(text) > MAX_SUBTITLE_LETTERS:
        found = f"{len(text)} characters; expected at most {MAX_SUBTITLE_LETTERS}"
        raise UserError(f"{shown(path)} has {found}: cut the file")
    is_vtt = text.lstrip().startswith("WEBVTT")
    lines = [line.strip(" \t") or line[:1] for line in text.split("\n")]
    borders = [number for number, line in enumerate(lines) if "-->" in line and line.removeprefix("-")[0].isdigit()]
    cues = []
    for border, after in itertools.pairwise([*borders, len(lines) + 1]):
        body = lines[border + 1 : after]
        if is_vtt:
            body = list(itertools.takewhile(bool, body))  # a line of one blank, as YouTube writes, ends no cue
        elif after < len(lines) and body and body[-1].isdecimal():
            del body[-1]  # the number of the next cue
        if match := _TIMES.match(lines[border]):
            cues.append(Stretch("\n".join(body).strip(), _to_seconds(match[1]), _to_seconds(match[2])))
    if not cues:
        raise UserError(f"{shown(path)} has no subtitles with times; export it again as SubRip or WebVTT")
    if len(cues) < len(borders):
        num_unread = len(borders) - len(cues)
        _logger.warning("%s: %d of %d cues cannot be read; left out", shown(path), num_unread, len(borders))
    if any(_INLINE_TIME.search(cue.text) for cue in cues) or _is_rolling(cues):
        return [Tier("", _timed_words(cues))]
    texts = [cue.text.replace("<u>", "").replace("</u>", "") for cue in cues]
    underlined = [_UNDERLINED.findall(cue.text) for cue in cues]
    # Whisper's --highlight_words shows the whole line once for each word, with that word underlined.
    repeated = sum(
        bool(words) and text in (*texts[max(i - 2, 0) : i], *texts[i + 1 : i + 3])
        for i, (text, words) in enumerate(zip(texts, underlined))
    )
    if 2 * repeated > sum(map(bool, underlined)):
        cues = [cue._replace(text=" ".join(words)) for cue, words in zip(cues, underlined, strict=True)]
    return [Tier("", cues)]


def _is_rolling(cues: Sequence[Stretch]) -> bool:
    """Return whether most cues begin with the last lines of the one before, as YouTube's do without times of words."""
    lines = [[line for line in cue.text.split("\n") if line.strip()] for cue in cues]
    rolled = [
        any(after[:count] == before[-count:] for count in range(1, len(before) + 1))
        for before, after in itertools.pairwise(lines)
    ]
    return len(rolled) > 1 and 2 * sum(rolled) > len(rolled)


def _timed_words(cues: Sequence[Stretch]) -> list[Stretch]:
    """Return the words of cues such as `so<00:00:00.320><c> today</c>`.

    YouTube shows every line twice, first while it is spoken and then, without times, above the next one, so the last
    lines of a cue that has just ended are not read again. The files have only starts of words; a word before a pause
    does not last until the end of the pause.
    """
    labels = find_labels([to_lines(cue.text) for cue in cues])
    stretches: list[Stretch] = []
    shown: list[str] = []
    speaker, ended = "", 0.0
    for cue in cues:
        by_line = [(line, _spoken(line, labels)) for line in cue.text.split("\n")]
        lines = [line for line, words in by_line if words]
        plain = [words for _, words in by_line if words]
        untimed = len([*itertools.takewhile(lambda line: not _INLINE_TIME.search(line), lines)])
        cue_start, cue_end = cue.start or 0.0, cue.end or 0.0
        most = untimed if cue_start - ended < _PAUSE else 0
        known = next((count for count in range(most, 0, -1) if plain[:count] == shown[-count:]), 0)
        shown, ended = plain, cue_end
        # [text, time, text, time, text ...]
        parts = _INLINE_TIME.split("\n".join(lines[known:]))
        times = [cue_start, *map(_to_seconds, parts[1::2]), cue_end]
        for part, start, end in zip(parts[::2], times[:-1], times[1:], strict=True):
            speaker = next((name for name, _ in reversed(turns(part, labels)) if name is not None), speaker)
            words = _spoken(part, labels)
            stretches.append(Stretch(words, start, min(end, start + longest(words)), speaker))
    return stretches


def _spoken(raw: str, labels: set[str]) -> str:
    return " ".join(word for _, text in turns(raw, labels) for word in split_words(text))


def _to_seconds(time: str) -> float:
    *hours, minutes, seconds = time.removeprefix("-").replace(",", ".").split(":")
    found = 3600 * int(hours[0] if hours else 0) + 60 * int(minutes) + float(seconds)
    return -found if time.startswith("-") else found  # from a file whose times an editor has shifted
