"""Parsers of words in tables and in JSON, which recognise columns and keys by their names, whatever wrote them."""

import csv
import functools
import itertools
import json
import math
import pathlib
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from ha2g_jax.errors import UserError
from ha2g_jax.features.words.textgrid import Tier
from ha2g_jax.features.words.timing import Stretch, fill_gaps, num_letters, with_ends
from ha2g_jax.files.reading import parse_json, reason, shown

# Role of a column or key -> its possible names without the unit, the best name first.
_ROLES = {
    "start": "start, start time, begin, begin time, onset, xmin, tmin, from, time start, time, timestamp, ts, "
    "t start, t offset, t 0, in",
    "end": "end, end time, stop, stop time, xmax, tmax, to, time end, end ts, finish, t 1, out",
    "offset": "offset",  # the end beside a start, the start beside a duration
    "duration": "duration, dur, length, d duration",
    "text": "word, text, punctuated word, token, label, transcript, transcription, content, value, utterance, "
    "sentence, phrase, annotation, subtitle, caption, utf 8",
    "speaker": "speaker, speaker id, speaker name, speaker label, speaker tag, participant, voice, channel, "
    "channel label",
    "tier": "tier, tier name, type",
}
_RANKS = {name.strip(): (role, rank) for role, names in _ROLES.items() for rank, name in enumerate(names.split(","))}
_SECONDS = {
    1.0: "s, sec, secs, second, seconds, ss msec, hh mm ss ms, hh mm ss, mm ss",
    1e-3: "ms, msec, msecs, millis, millisecond, milliseconds",
    1e-6: "us, µs, microseconds",
    1e-7: "ticks",
    1e-9: "ns, nanoseconds",
    60.0: "min, minutes",
}
_UNITS = {name.strip(): seconds for seconds, names in _SECONDS.items() for name in names.split(",")}
_NAME_PART = re.compile(r"[A-Z]?[a-zµ]+|[A-Z]+(?![a-z])|[0-9]+")
# Vosk writes one object after the other.
_BETWEEN_OBJECTS = re.compile(r"\}[ \t]*\n\s*\{")
_MAX_ROW = 1 << 16
# File, channel, start, duration and word of a line of NIST's CTM, and perhaps more.
_NUMBER = r"(?:[0-9]+\.?[0-9]*|\.[0-9]+)"
_CTM = re.compile(rf"\S+ +\S+ +{_NUMBER} +{_NUMBER} +\S+(?: +\S+){{0,3}}")
_CTM_COLUMNS = "tier\tspeaker\tstart\tduration\tword"
_ROUNDED = 0.011  # seconds by which a length and the difference of two times may differ
# Speech has 5 to 25 letters a second; milliseconds read as seconds give a thousandth of that.
_LEAST_LETTERS, _USUAL_LETTERS = 0.05, 12.0
_SMALL_UNITS = (1e-3, 1e-6, 1e-7, 1e-9)  # seconds
# An entry of the speech marks of AWS Polly; its start and end are bytes of the text.
_SPEECH_MARK = {"time", "type", "value"}


# Programs, the path to their words or segments, and the paths to values that are nested deeper. The parts of a path are
# keys; a number takes one item of a list, a key is looked up in each of its items.
_DIALECTS: tuple[tuple[str, str, dict[str, str]], ...] = (
    ("Whisper, OpenAI", "segments", {}),
    ("Gentle, AssemblyAI, ElevenLabs", "words", {}),
    ("AssemblyAI", "utterances", {}),
    ("whisperX", "word_segments", {}),
    ("Seamless Interaction", "metadata:transcript", {}),
    ("whisper.cpp", "transcription", {"start ms": "offsets.from", "end ms": "offsets.to"}),
    ("whisper.cpp", "transcription", {"start": "timestamps.from", "end": "timestamps.to"}),
    ("transformers", "chunks", {"start": "timestamp.0", "end": "timestamp.1"}),
    ("Vosk", "result", {}),
    ("Vosk", "alternatives.0.result", {}),
    ("Rev", "monologues", {}),
    ("Deepgram", "results.channels.alternatives.0.words", {}),
    ("Deepgram", "results.utterances", {}),
    ("Gladia", "result.transcription.utterances", {}),
    ("AWS Transcribe", "results.items", {"text": "alternatives.0.content"}),
    ("Google", "results.alternatives.0.words", {"start": "startOffset", "end": "endOffset"}),
    ("Google", "response.results.alternatives.0.words", {}),
    ("Watson", "results.alternatives.0.timestamps", {}),
    ("NeMo", "timestamp.word", {}),
    ("Speechmatics", "results", {"text": "alternatives.0.content", "speaker": "alternatives.0.speaker"}),
    ("Azure", "phrases", {}),
    ("Azure", "recognizedPhrases.nBest.0.words", {}),
    ("Azure", "recognizedPhrases", {"text": "nBest.0.display"}),
    ("Azure", "NBest.0.Words", {"start ticks": "Offset", "duration ticks": "Duration"}),
    ("YouTube", "events", {}),
    ("aeneas", "fragments", {"text": "lines"}),
    ("Soniox, Polly, edge-tts, a list of words or segments", "", {}),
)
# Keys of the words in a segment.
_PARTS = ("words", "elements", "terms", "tokens", "segs")
PROGRAMS = ", ".join(
    dict.fromkeys(["Montreal Forced Aligner", *(name for names, *_ in _DIALECTS for name in names.split(", "))])
)


@functools.lru_cache(1024)
def _columns(names: Sequence[str]) -> dict[str, tuple[int, float | None]]:
    """Return the position of each role among names such as `startMs` or `start (ms)`, and its unit in seconds."""
    found = []
    for place, name in enumerate(names):
        parts = [part.lower() for part in _NAME_PART.findall(name)]
        unit = None
        for count in range(min(4, len(parts) - 1), 0, -1):
            if (unit := _UNITS.get(" ".join(parts[-count:]))) is not None:
                parts = parts[:-count]
                break
        if unit is not None and len(parts) > 1 and parts[-1] == "in":
            del parts[-1]
        if role := _RANKS.get(" ".join(parts)):
            found.append((role[1], unit is None, place, role[0], unit))
    columns: dict[str, tuple[int, float | None]] = {}
    for _, _, place, role, unit in sorted(found):
        columns.setdefault(role, (place, unit))
    if "offset" in columns and not ("start" in columns and "duration" in columns):
        columns.setdefault("end" if "start" in columns else "start", columns["offset"])
    return columns


def _time(value: object, unit: float | None) -> float | None:
    """Return a time in seconds: a number in its unit, or a text such as 1.5, 1,5, 1.5s or 0:01.5; None if empty."""
    if value is None or value == "":
        return None
    if isinstance(value, dict) and value.keys() <= {"seconds", "nanos"}:  # of Google
        return float(value.get("seconds") or 0) + 1e-9 * float(value.get("nanos") or 0)
    if isinstance(value, bool) or not isinstance(value, str | int | float):
        raise TypeError(f"the time {str(value)[:40]!r} is not a number")
    if not isinstance(value, str):
        return float(value) * (unit or 1.0)
    *larger, last = value.strip().replace(",", ".").removesuffix("s").split(":")
    if len(larger) > 2:
        raise ValueError(f"the time {value[:40]!r} is not hours:minutes:seconds")
    seconds = float(last) if larger else float(last) * (unit or 1.0)
    return sum((60.0**power * float(part) for power, part in enumerate(reversed(larger), start=1)), start=seconds)


def _stretch(values: Sequence[Any], columns: Mapping[str, tuple[int, float | None]]) -> Stretch:
    cells = {role: values[place] for role, (place, _) in columns.items()}
    times = {role: _time(cells.get(role), columns[role][1]) for role in ("start", "end", "duration") if role in columns}
    start, end, duration = times.get("start"), times.get("end"), times.get("duration")
    if end is None and start is not None and duration is not None:
        end = start + duration
    speaker, text = cells.get("speaker"), cells.get("text")
    return Stretch(
        "" if text is None else _text(text), start, end, str(speaker) if isinstance(speaker, str | int) else ""
    )


def _in_seconds(stretches: Sequence[Stretch]) -> list[Stretch]:
    """Convert times in a smaller unit: whole numbers that as seconds would make speech far too slow."""
    seconds = letters = 0.0
    for text, start, end, _ in with_ends(stretches):
        if start is not None and end is not None:
            seconds, letters = seconds + end - start, letters + num_letters(text)
    times = [(one.start, one.end) for one in stretches]
    if not letters < _LEAST_LETTERS * seconds or any(time and not time.is_integer() for pair in times for time in pair):
        return [*stretches]
    unit = min(_SMALL_UNITS, key=lambda unit: abs(math.log(max(letters, 1.0) / (unit * seconds) / _USUAL_LETTERS)))
    scaled = [[time if time is None else time * unit for time in pair] for pair in times]
    return [one._replace(start=start, end=end) for one, (start, end) in zip(stretches, scaled, strict=True)]


def is_table(text: str) -> bool:
    """Return whether most lines have two times and a text, like Audacity's labels, or the first names such columns."""
    lines, separator = _table_lines(text)
    if not separator or len(lines[0]) > _MAX_ROW:
        return False
    names = _columns(tuple(lines[0].split(separator)))
    if "start" in names and ("end" in names or "duration" in names):
        return True
    rows = [line.split(separator) for line in lines if line and not line.startswith("\\")]
    return 2 * sum(_columns_by_values(row) is not None for row in rows) > len(rows)


def parse_table(text: str, path: pathlib.Path) -> list[Tier]:
    """Parse a table of words or lines of a file at `path`, separated by tabs, semicolons or commas, or in NIST's CTM.

    The first line names the columns, in any order: start (or begin, time ...), end or duration, word (or text, label
    ...), and perhaps speaker and tier; without a word, each column of another name is a tier of words. A unit may stand
    in the name, as in `start_ms` and `start (ms)`; without one, times are seconds, or in a smaller unit if they are
    whole numbers at which speech would be far too slow. Without names the word is the last column, after start and end.

    Raises:
        UserError: a column is missing, or a row is damaged.
    """
    rows, name = _rows(text, path), shown(path)
    number, header = next(rows, (0, None))
    if header is None:
        raise UserError(f"{name} has no rows; expected start, end and word in each")
    columns = _columns(tuple(header))
    others = {place: name for place, name in enumerate(header) if place not in {place for place, _ in columns.values()}}
    if "start" not in columns or not ("text" in columns or ("end" in columns and others)):
        found = _columns_by_values(header)
        if found is None:
            raise UserError(f"{name} has the columns {', '.join(header)[:80]}; expected start, end and word")
        rows = [(number, header), *rows]
        if found["start"][0] == 1 and len({row[0] for _, row in rows}) == len(rows):
            found.pop("tier", None)  # each row has a name of its own
        columns = found
        header = header[: found["text"][0] + 1]
    if "text" in columns:
        others = {columns["text"][0]: ""}
    tiers: dict[str, list[Stretch]] = {}
    for number, row in rows:
        if len(row) > len(header) and columns.get("text", (-1,))[0] == len(header) - 1:
            row[len(header) - 1 :] = [", ".join(row[len(header) - 1 :])]  # commas in a text without quotes
        try:
            for place, tier in others.items():
                if tier and not row[place].strip():
                    continue
                tier = row[columns["tier"][0]] if "tier" in columns else tier
                tiers.setdefault(tier, []).append(_stretch(row, {**columns, "text": (place, None)}))
        except IndexError as error:
            problem = f"has {len(row)} columns instead of {1 + max(*others, *(place for place, _ in columns.values()))}"
            raise UserError(f"{name}, line {number}, {problem}; correct it") from error
        except ValueError as error:
            problem = f"has a time that is not a number ({reason(error)[:80]})"
            raise UserError(f"{name}, line {number}, {problem}; correct it") from error
    has_unit = any(unit is not None for _, unit in columns.values())
    return [Tier(tier, [*stretches] if has_unit else _in_seconds(stretches)) for tier, stretches in tiers.items()]


def _columns_by_values(row: Sequence[str]) -> dict[str, tuple[int, float | None]] | None:
    """Return the columns of a row of a table without column names, such as those of Audacity, ELAN and aeneas; None if
    there are no two times before a text.

    ELAN writes the tier, perhaps the participant, and start, end and length, each of them in one or more units. Of
    three numbers that are not these, the first is that of the row.
    """
    first = next((place for place, field in enumerate(row[:3]) if _is_number(field)), len(row))
    count = len([*itertools.takewhile(_is_number, row[first:-1])])
    if count not in (2, 3, 4, 6, 9):
        return None
    end, text = first + (count // 3 if count % 3 == 0 else count // 2), first + count
    if count == 3:
        start, stop, length = (_time(field, None) or 0.0 for field in row[first:text])
        if abs(stop - start - length) > _ROUNDED:
            if stop > length:
                return None
            first, end = first + 1, end + 1
    columns: dict[str, tuple[int, float | None]] = {"start": (first, None), "end": (end, None), "text": (text, None)}
    return columns | ({"tier": (0, None)} if first in (1, 2) and not _is_number(row[0]) else {})


def _table_lines(text: str) -> tuple[list[str], str]:
    """Return the lines of a table and the separator of its columns, "" for an empty table."""
    lines = text.lstrip("\n").split("\n")
    if named := re.fullmatch(r"sep=(.)\r?", lines[0]):  # as Excel writes
        return ["", *lines[1:]], named[1]
    spoken = [line for line in lines if line.strip() and not line.startswith(";;")]
    if len(spoken) < 2 * sum(bool(_CTM.fullmatch(line[:_MAX_ROW])) for line in spoken):
        return [_CTM_COLUMNS, *("\t".join(line.split()[:5]) for line in spoken)], "\t"
    return lines, _separator(lines[0])


def _separator(line: str) -> str:
    first = line.split(";")[0]
    is_semicolon = ";" in line and ("," not in first or _is_number(first))
    return "\t" if "\t" in line else ";" if is_semicolon else "," if "," in line else ""


def _rows(text: str, path: pathlib.Path) -> Iterator[tuple[int, list[str]]]:
    """Yield the line number and the fields of each row, without the frequencies of Audacity's labels."""
    lines, separator = _table_lines(text.replace("\t", " ") if path.suffix.lower() == ".ctm" else text)
    if max(map(len, lines)) > _MAX_ROW:
        raise UserError(f"{shown(path)} has a line of more than {_MAX_ROW} characters; expected start, end and word")
    # Programs that write tabs do not quote, and a transcript may have a single quotation mark.
    quoting = csv.QUOTE_NONE if separator == "\t" else csv.QUOTE_MINIMAL
    reader = csv.reader((f"{line}\n" for line in lines), delimiter=separator or ",", quoting=quoting, strict=True)
    try:
        for row in reader:
            if any(field.strip() for field in row) and row[0] != "\\":
                yield reader.line_num, row
    except csv.Error as error:
        raise UserError(f"{shown(path)}, line {reader.line_num}, is damaged ({error}); export it again") from error


def _is_number(field: str) -> bool:
    try:
        return bool(field.strip()) and _time(field, None) is not None
    except ValueError:
        return False


def parse_json_words(text: str, path: pathlib.Path) -> list[Tier]:
    """Parse the words in JSON of any of `PROGRAMS`: a stretch per word, or per segment for segments without words.

    Raises:
        UserError: the text is not JSON of one of these programs.
    """
    try:
        joined = _BETWEEN_OBJECTS.sub("},{", text)
        content = parse_json(text if joined == text else f"[{joined}]")
        if isinstance(content, dict) and content.get("tiers"):
            return [Tier(name, _read(entries, {})) for name, entries in _tiers(content["tiers"])]
        # OpenAI's service returns segments without words, and a separate list of words; segments in a list may have
        # no words, too.
        last = {"segments"} if isinstance(content, dict) and not _under(content, "segments.words") else set[str]()
        last |= {dialect for _, dialect, _ in _DIALECTS if dialect} if isinstance(content, list) else set()
        for _, dialect, deeper in sorted(_DIALECTS, key=lambda one: one[1] in last):
            is_one = isinstance(content, dict) and not dialect
            stretches = _read([content] if is_one else _under(content, dialect), deeper)
            if any(one.start is not None for one in stretches):
                return [Tier("", stretches)]
    except json.JSONDecodeError as error:
        raise UserError(f"{shown(path)} is damaged JSON ({error}); export the transcript again, whole") from error
    except (ValueError, TypeError, AttributeError, KeyError, OverflowError) as error:
        found = f"{type(error).__name__}: {reason(error)[:80]}"
        raise UserError(f"{shown(path)} has damaged words in JSON ({found}); export the transcript again") from error
    raise UserError(f"{shown(path)} is JSON without words that have times; expected that of {PROGRAMS}")


def _tiers(tiers: Any) -> Iterator[tuple[str, list[Any]]]:
    """Yield the names and entries [start, end, label] of tiers in JSON, as the Montreal aligner and praatio write."""
    pairs = tiers.items() if isinstance(tiers, dict) else ((tier["name"], tier) for tier in tiers)
    for name, tier in pairs:
        if tier.get("type", tier.get("class")) in ("interval", "IntervalTier", None):
            yield _text(name), _under(tier, "entries")


def _under(value: Any, path: str) -> list[Any]:
    """Return the values at a path; see `_DIALECTS`."""
    while path and value is not None:
        key, _, rest = path.partition(".")
        if isinstance(value, list) and not key.isdecimal():
            return [found for item in value for found in _under(item, path)]
        if isinstance(value, list):
            value = value[int(key)] if int(key) < len(value) else None
        else:
            value = value.get(key) if isinstance(value, dict) else None
        path = rest
    return value if isinstance(value, list) else [value] if isinstance(value, str | int | float) else []


def _read(
    entries: Iterable[Any], deeper: Mapping[str, str], start: float | None = 0.0, end: float | None = None
) -> list[Stretch]:
    """Return a stretch per word of the entries, which are spoken from `start` to `end`, or per segment without words.

    Gentle's words of the case `not-found-in-audio` and whisperX's words that its aligner cannot spell, such as numbers,
    have no times. The latter were spoken and get the gap between their neighbours; the former only if they fit in it.
    """
    result: list[Stretch] = []
    has_unit, is_gentle = False, False
    for entry in entries:
        if isinstance(entry, list) and len(entry) == 3:
            entry = dict[str, Any](
                zip(("text", "start", "end"), sorted(entry, key=lambda value: not isinstance(value, str)))
            )
        if not isinstance(entry, dict):
            continue
        if entry.keys() >= _SPEECH_MARK:
            if entry["type"] != "word":
                continue
            entry = {"start ms": entry["time"], "text": entry["value"]}
        for key, path in deeper.items():
            if found := _under(entry, path):
                entry = dict[str, Any]({key: found[0] if len(found) == 1 else "\n".join(map(_text, found)), **entry})
        columns = _columns(tuple(entry))
        parts = next(((name, entry[name]) for name in _PARTS if isinstance(entry.get(name), list)), None)
        if "text" not in columns and parts is None:
            continue
        has_unit |= any(unit is not None for _, unit in columns.values())
        one = _stretch(tuple(entry.values()), columns)
        if words := _read_parts(*parts, deeper, one) if parts else []:
            result += [word._replace(speaker=word.speaker or one.speaker) for word in words]
            continue
        if entry.get("case") == "not-found-in-audio":
            one = one._replace(start=None, end=None)
        is_gentle |= "case" in entry
        result.append(one)
    return fill_gaps(result if has_unit else _in_seconds(result), start, end, slack=0.0 if is_gentle else math.inf)


def _read_parts(name: str, parts: list[Any], deeper: Mapping[str, str], whole: Stretch) -> list[Stretch]:
    """Return the words of a segment, as `_read` does."""
    if name == "segs" and whole.start is not None:  # of YouTube, with times from the start of the segment
        start = whole.start
        words = _read(parts, deeper, 0.0, None if whole.end is None else whole.end - start)
        return [one._replace(start=start + (one.start or 0.0), end=one.end and start + one.end) for one in words]
    words = _read(parts, deeper, whole.start, whole.end)
    if name != "tokens" or not any(one.text[:1].isspace() for one in words):
        return words
    joined: list[Stretch] = []  # tokens are parts of words, each of which begins with a blank
    for one in words:
        if joined and not one.text[:1].isspace() and not one.text.startswith("[_"):  # as [_BEG_] and [_TT_75]
            joined[-1] = joined[-1]._replace(text=joined[-1].text + one.text, end=one.end)
        elif not one.text.startswith("[_"):
            joined.append(one)
    return joined


def _text(value: object) -> str:
    """Return a JSON value as text; numbers are words too, and unpaired surrogates are dropped."""
    if not isinstance(value, str | int | float) or isinstance(value, bool):
        raise TypeError(f"a {type(value).__name__} instead of a text")
    return str(value).encode("utf-8", "replace").decode("utf-8")
