"""Words of a recording: the transcript beside it, and its readers, which are chosen by the suffix of the file."""

import codecs
import csv
import json
import logging
import math
import pathlib
import re
from collections.abc import Iterator
from typing import Any

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import SAMPLE_RATE, sound_start
from ha2g_jax.features.text import Word
from ha2g_jax.features.words.parsers import parse_srt, parse_textgrid, parse_vtt, without_brackets
from ha2g_jax.features.words.timing import Stretch, fill_gaps, inside, to_words
from ha2g_jax.files.reading import check_regular, parse_json, reading, reason, shown
from ha2g_jax.limits import MAX_TRANSCRIPT_BYTES, MAX_TRANSCRIPT_LINES

_EXPECTED = "a transcript"
_BYTE_ORDER_MARKS = {codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}
_CONTROLS = {*map(chr, range(32)), "\x7f", "\ufffe"} - set("\t\n\r\f\v")
_logger = logging.getLogger(__name__)

# Formats with a time for each word come first, a text without times last.
_SUBTITLES = (".vtt", ".srt")
_PREFERENCE = (".textgrid", ".json", ".tsv", ".csv", ".vtt", ".srt", ".txt")
_LANGUAGE = re.compile(r"\.[a-z]{2,3}(?:-[a-zA-Z]{2,8})?")

_COLUMNS = {
    "start": ("start", "begin", "onset", "start_time", "start time", "xmin", "tmin"),
    "end": ("end", "stop", "offset", "end_time", "end time", "xmax", "tmax"),
    "text": ("word", "text", "token", "label"),
}
_MAX_ROW = 1 << 16


def words_of(
    audio: np.ndarray, path: pathlib.Path | None, *, recognise: str | None, media: pathlib.Path | None = None
) -> tuple[Word, ...]:
    """Return the words within a recording (samples,) float32 at 16 kHz, in seconds from its start.

    They are read from a transcript that `read_words` reads, aligned from a .txt file without times, or, if `path` is
    None, recognised by the Whisper model of the name or folder `recognise`. Subtitles have the clock of the images of
    `media`, the file of the recording, whose sound may start later.

    Raises:
        UserError: there is neither a transcript nor a model, or one of them fails.
    """
    if path is None:
        if recognise is None:
            raise UserError(
                "the recording has no transcript beside it; give one (.TextGrid .json .srt .vtt .tsv .txt) or the name "
                "of a Whisper model that recognises the words, such as tiny.en"
            )
        from ha2g_jax.features.words import alignment

        words = alignment.recognise(audio, model=recognise)
    elif path.suffix.lower() == ".txt":
        from ha2g_jax.features.words import alignment

        words = alignment.align(audio, _read_text(path))
    else:
        words = read_words(path)
        if media is not None and path.suffix.lower() in _SUBTITLES and (start := sound_start(media)):
            words = [Word(word.text, word.start - start, word.end - start) for word in words]
    return inside(words, len(audio) / SAMPLE_RATE)


def find(media: pathlib.Path, *, is_alone: bool = True) -> pathlib.Path | None:
    """Find the transcript of a recording in its folder.

    The first match wins: a file with the recording's stem; with the stem and a language, as in `talk.en.vtt`; with the
    stem cut at its last dot, and so on; the only file called `words.*`, if no other recording is in the folder. The
    order among files of one stem is .TextGrid, .json, .tsv, .csv, .vtt, .srt, .txt. Returns None if there is none.

    Args:
        media: path of the audio, video or motion file of the recording, which need not exist.
        is_alone: whether no other recording is in the folder.
    """
    media = pathlib.Path(media)
    if not media.parent.is_dir():
        return None
    names = (path for path in media.parent.iterdir() if path.suffix.lower() in _PREFERENCE and path != media)
    files = sorted(
        (path for path in names if path.is_file()), key=lambda path: (_PREFERENCE.index(path.suffix.lower()), path.name)
    )
    stem = media.stem
    while stem:
        of_stem = [path for path in files if path.stem == stem]
        in_language = [
            path for path in files if path.stem.startswith(stem) and _LANGUAGE.fullmatch(path.stem[len(stem) :])
        ]
        if of_stem or in_language:
            return (of_stem or in_language)[0]
        stem = stem.rpartition(".")[0]
    called_words = [path for path in files if path.stem == "words"]
    return called_words[0] if is_alone and len(called_words) == 1 else None


def read_words(path: pathlib.Path) -> tuple[Word, ...]:
    """Read a transcript with times: TextGrid, Gentle, Whisper or whisperX JSON, SRT, VTT, TSV or CSV.

    If a file has times only for lines or segments, these are divided among their words by letters. The words are in
    lower case without punctuation, in order of time, not overlapping, 0 <= start < end in seconds.

    Raises:
        UserError: the file cannot be read, or has no words, impossible times, or no times.
    """
    path = pathlib.Path(path)
    suffix = path.suffix.lower()
    if suffix == ".txt":
        raise UserError(
            f"{shown(path)} is a text without times; expected a transcript with times, or a text "
            "together with its audio"
        )
    if suffix not in _FORMATS:
        raise UserError(
            f"{shown(path)} is not a transcript of a known format; expected one of .TextGrid .json .tsv .csv .vtt .srt"
        )
    text = _read_text(path)
    parse = _FORMATS[suffix]
    if suffix in _SUBTITLES:  # often one has the suffix of the other
        parse = parse_vtt if text.lstrip().startswith("WEBVTT") else parse_srt
    words = to_words(parse(text, path), path)
    if not words:
        raise UserError(f"{shown(path)} has no words with times; expected a transcript of the recording")
    return words


def _read_text(path: pathlib.Path) -> str:
    """Read a text file in UTF-8, UTF-16 with a byte order mark, or else Windows-1252, with line ends as \\n."""
    check_regular(path, _EXPECTED)  # reading a pipe would wait for ever
    with reading(path, _EXPECTED), path.open("rb") as file:
        data = file.read(MAX_TRANSCRIPT_BYTES + 1)
    if not data:
        raise UserError(f"{shown(path)} is an empty file; expected a transcript")
    if len(data) > MAX_TRANSCRIPT_BYTES:
        size = f"{MAX_TRANSCRIPT_BYTES >> 20} MiB"
        raise UserError(f"{shown(path)} is larger than {size}; expected the transcript of one recording")
    text = _decode(data, path).replace("\r\n", "\n").replace("\r", "\n")
    if text.count("\n") > MAX_TRANSCRIPT_LINES:
        raise UserError(f"{shown(path)} has more than {MAX_TRANSCRIPT_LINES} lines; expected a transcript")
    if not _CONTROLS.isdisjoint(text):
        raise UserError(f"{shown(path)} has binary data; expected a transcript")
    if not text.strip():
        raise UserError(f"{shown(path)} has nothing but white space; expected a transcript")
    return text


def _decode(data: bytes, path: pathlib.Path) -> str:
    encoding = next((name for mark, name in _BYTE_ORDER_MARKS.items() if data.startswith(mark)), "utf-8")
    try:
        return data.decode(encoding)
    except UnicodeDecodeError as error:
        if encoding != "utf-8":
            raise UserError(f"{shown(path)} is not valid {encoding} text ({error.reason}); save it as UTF-8") from error
    try:
        text = data.decode("cp1252")
    except UnicodeDecodeError as error:
        raise UserError(f"{shown(path)} is not text in UTF-8, UTF-16 or Windows-1252; save it as UTF-8") from error
    _logger.warning("%s is not UTF-8; read as Windows-1252", shown(path))
    return text


def _parse_table(text: str, path: pathlib.Path) -> list[Stretch]:
    """Parse a table with the columns start, end and word, separated by tabs or commas.

    The first line names the columns start, end and word (or text); without such a line the columns are start, end,
    word. Times are seconds. If the third column is called `text` and all times are integers, as in Whisper's tables,
    they are milliseconds.
    """
    rows, name = _rows(text, path), shown(path)
    number, header = next(rows, (0, None))
    if header is None:
        raise UserError(f"{name} has no rows; expected start, end and word in each")
    names = [field.strip().lower() for field in header]
    columns = {key: next((names.index(name) for name in known if name in names), -1) for key, known in _COLUMNS.items()}
    may_be_milliseconds = columns["text"] >= 0 and names[columns["text"]] == "text"
    stretches = []
    if -1 in columns.values():
        columns, may_be_milliseconds = {"start": 0, "end": 1, "text": 2}, False
        if len(names) != 3 or not _is_number(names[0]):
            raise UserError(f"{shown(path)} has the columns {', '.join(names)[:80]}; expected start, end and word")
        stretches.append(_stretch(header, columns, f"{name}, line {number},"))
    for number, row in rows:
        may_be_milliseconds &= all(row[columns[key]].isdecimal() for key in ("start", "end") if columns[key] < len(row))
        stretches.append(_stretch(row, columns, f"{name}, line {number},"))
    if may_be_milliseconds:
        return [Stretch(text, start / 1000, end / 1000) for text, start, end in stretches]
    return stretches


def _rows(text: str, path: pathlib.Path) -> Iterator[tuple[int, list[str]]]:
    """Yield the line number and the fields of each row."""
    lines = text.lstrip("\n").split("\n")
    if max(map(len, lines)) > _MAX_ROW:
        raise UserError(
            f"{shown(path)} has a line of more than {_MAX_ROW} characters; expected start, end and word in each"
        )
    # Tools that write tabs do not quote, and a transcript may have a single quotation mark.
    style = {"delimiter": "\t", "quoting": csv.QUOTE_NONE} if "\t" in lines[0] else {"delimiter": ",", "strict": True}
    reader = csv.reader(lines, **style)
    try:
        for row in reader:
            if any(field.strip() for field in row):
                yield reader.line_num, row
    except csv.Error as error:
        raise UserError(
            f"{shown(path)}, line {reader.line_num}, is damaged ({error}); export the table again"
        ) from error


def _is_number(field: str) -> bool:
    try:
        float(field)
    except ValueError:
        return False
    return True


def _stretch(row: list[str], columns: dict[str, int], name: str) -> Stretch:
    try:
        start, end, text = (row[columns[key]] for key in ("start", "end", "text"))
        return Stretch(text, float(start), float(end))
    except IndexError as error:
        raise UserError(f"{name} has {len(row)} columns instead of {1 + max(columns.values())}; correct it") from error
    except ValueError as error:
        raise UserError(f"{name} has a time that is not a number ({str(error)[:80]}); correct it") from error


def _parse_json(text: str, path: pathlib.Path) -> list[Stretch]:
    """Parse the JSON of Whisper, whisperX, faster-whisper, Gentle or Seamless: a stretch per word, or per segment for
    segments without words.
    """
    try:
        content = parse_json(text)
        # Seamless Interaction has the segments of whisperX under a name of its own.
        segments = content.get("segments") or content.get("metadata:transcript")
        words = content.get("words", content.get("word_segments"))
        # OpenAI's service returns segments without words, and a separate list of words.
        if segments and (not words or any(segment.get("words") for segment in segments)):
            return [stretch for segment in segments for stretch in _segment(segment)]
        if words and any("case" in word for word in words):
            return fill_gaps([_gentle_word(word) for word in words], 0.0, None)
        if words:
            return fill_gaps([_word(word) for word in words], 0.0, None, slack=math.inf)
    except json.JSONDecodeError as error:
        raise UserError(f"{shown(path)} is damaged JSON ({error}); export the transcript again, whole") from error
    except (ValueError, TypeError, AttributeError, KeyError, OverflowError) as error:
        found = f"{type(error).__name__}: {reason(error)[:80]}"
        raise UserError(
            f"{shown(path)} is not JSON of Gentle, Whisper or whisperX ({found}); export it again"
        ) from error
    raise UserError(
        f"{shown(path)} is JSON without `segments` or `words`; expected the output of Gentle, Whisper or whisperX"
    )


def _segment(segment: dict[str, Any]) -> list[Stretch]:
    """Return the words of a Whisper segment, or its text as one stretch if it has none.

    whisperX gives no times for words that its aligner cannot spell, such as numbers. They were spoken nevertheless, so
    they get the gap between their neighbours.
    """
    start, end = _seconds(segment.get("start")), _seconds(segment.get("end"))
    words = [_word(word) for word in segment.get("words") or []]
    if any(word.start is not None for word in words):
        return fill_gaps(words, start, end, slack=math.inf)
    return [Stretch(_spoken(segment["text"] if "text" in segment else segment["transcript"]), start, end)]


def _word(word: dict[str, Any]) -> Stretch:
    # openai-whisper, faster-whisper and whisperX have "word", older whisperX and some exports "text".
    text = word["word"] if "word" in word else word["text"]
    return Stretch(_spoken(text), _seconds(word.get("start")), _seconds(word.get("end")))


def _gentle_word(word: dict[str, Any]) -> Stretch:
    """Return a word of Gentle.

    A word of the case `not-found-in-audio` has no times. If it was spoken, it fits in the gap between its neighbours;
    if it is superfluous in the transcript, it does not. `fill_gaps` distinguishes the two cases.
    """
    if word.get("case", "success") == "not-found-in-audio":
        return Stretch(_text(word["word"]), None, None)
    return Stretch(_text(word["word"]), _seconds(word.get("start")), _seconds(word.get("end")))


def _spoken(text: object) -> str:
    """Return a text without the sounds that are not words, as Whisper and captions write them."""
    return without_brackets(_text(text).replace("\n", " "), "[(", " ").replace("♪", " ")


def _text(value: object) -> str:
    """Return a text of JSON; a number is a word, too, and half a pair of surrogates is no letter."""
    if not isinstance(value, str | int | float) or isinstance(value, bool):
        raise TypeError(f"a {type(value).__name__} instead of a text")
    return str(value).encode("utf-8", "replace").decode("utf-8")


def _seconds(value: object) -> float | None:
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"the time {str(value)[:40]!r} is not a number")
    return float(value)


_FORMATS = {
    ".textgrid": parse_textgrid,
    ".json": _parse_json,
    ".tsv": _parse_table,
    ".csv": _parse_table,
    ".vtt": parse_vtt,
    ".srt": parse_srt,
}
