"""Words of a recording: the transcript beside it, and its reader, which is chosen by the content of the file."""

import contextlib
import functools
import logging
import math
import os
import pathlib
import re
from collections.abc import Callable

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.features.media import sound_delay
from ha2g_jax.features.text import Word
from ha2g_jax.features.words.encodings import read_text
from ha2g_jax.features.words.entries import is_table, parse_json_words, parse_table
from ha2g_jax.features.words.subtitles import parse_subtitles
from ha2g_jax.features.words.textgrid import Tier, choose, parse_textgrid
from ha2g_jax.features.words.timing import Stretch, inside, to_words
from ha2g_jax.files.reading import folded, shown

_logger = logging.getLogger(__name__)

_LANGUAGE = re.compile(r"\.[a-z]{2,3}(?:-[a-zA-Z0-9]{2,8})?")

_MOTION = re.compile(rb'frame,time,|\{\s*"axes":')  # as the tables of ha2g export begin

_Parse = Callable[[str, pathlib.Path], list[Tier]]
# Formats with a time for each word come first, a text without times last.
_BY_SUFFIX: dict[str, _Parse] = {
    ".textgrid": parse_textgrid,
    ".json": parse_json_words,
    ".tsv": parse_table,
    ".csv": parse_table,
    ".ctm": parse_table,
    ".vtt": parse_subtitles,
    ".srt": parse_subtitles,
}
_PREFERENCE = (*_BY_SUFFIX, ".txt")
# How files begin, whatever their suffix.
_BY_BEGINNING: dict[str, _Parse] = {
    r"WEBVTT\b": parse_subtitles,
    r'(?:File type\s*=\s*)?"ooTextFile|"Praat chronological TextGrid': parse_textgrid,
    r"(?:[0-9]+[ \t]*\n\s*)?(?:[0-9]+:)?[0-9]+:[0-9]+[,.][0-9]+[ \t]*-->": parse_subtitles,
    r'\{\s*"|\[\s*[\[{]\s*["0-9]': parse_json_words,
}
# How lines of unsupported formats begin or end, such as [00:12.50] and Mary 0:03.
_CLOCK = r"(?:[0-9]+:)?[0-9]+:[0-9]{2}(?:[.,][0-9]+)?"
_CLOCK_LINE = re.compile(rf"(?m)^[\[(]?{_CLOCK}\b|\b{_CLOCK}[\])]?$")
_MARKUP = re.compile(r"\s*(?:<[?!a-zA-Z]|\[Script Info\])")


def words_of(
    audio: np.ndarray,
    path: pathlib.Path | None,
    *,
    recognise: str | None,
    media: pathlib.Path | None = None,
    speaker: str | None = None,
) -> tuple[Word, ...]:
    """Return the words within a recording (samples,) float32 at 16 kHz, in seconds from its start.

    They are read from a transcript that `read_words` reads, aligned from a .txt file without times, or, if `path` is
    None, recognised by the Whisper model of the name or folder `recognise`. Subtitles count from the beginning of
    `media`, the file of the recording, whose sound may start later. If a transcript has several speakers, the words are
    those of `speaker`, who is recorded, or of all if no name is given.

    Raises:
        UserError: there is neither a transcript nor a model, one of them fails, or none of several speakers has the
            name `speaker`.
    """
    duration = len(audio) / SAMPLE_RATE
    if path is None:
        if recognise is None:
            raise UserError(
                "the recording has no transcript beside it; give one (.TextGrid .json .srt .vtt .tsv .txt) or the name "
                "of a Whisper model that recognises the words, such as tiny.en"
            )
        from ha2g_jax.features.words import alignment

        return inside(alignment.recognise(audio, model=recognise), duration)
    file, chosen = split_speaker(path)
    text = read_text(file)
    if parse := _parser(text, file):
        words = _words(parse(text, file), chosen, file, duration, speaker)
        if media is not None and parse is parse_subtitles and (delay := sound_delay(media)):
            words = tuple(Word(word.text, word.start - delay, word.end - delay) for word in words)
        if not (heard := inside(words, duration)):
            raise UserError(
                f"{shown(file)} has words from {words[0].start:.1f} to {words[-1].end:.1f} s and the recording lasts "
                f"{duration:.1f} s; give the transcript of this recording"
            )
        return heard
    from ha2g_jax.features.words import alignment

    lines = [Stretch(line, number, number + 1) for number, line in enumerate(text.split("\n")) if line.strip()]
    chosen_lines = choose([Tier("", lines)], chosen, file, duration, speaker)
    return inside(alignment.align(audio, " ".join(one.text for one in chosen_lines)), duration)


@functools.cache  # once for each recording, however often its transcript is looked for
def _say_languages(media: pathlib.Path, names: tuple[str, ...]) -> None:
    listed = ", ".join(map(shown, names))
    _logger.warning("%s has transcripts in several languages (%s); the first is read", shown(media.name), listed)


def find(media: pathlib.Path, *, is_alone: bool = True) -> pathlib.Path | None:
    """Find the transcript of a recording in its folder.

    The first match wins: a file whose stem is the recording's name, such as talk.mp3.srt, or its stem, or one of these
    in other case; with the stem and a language, as in talk.en.vtt; with the stem cut at its last dot, and so on; the
    only file called words.*, if no other recording is in the folder. A file with the stem of another recording, such as
    interview.ann.srt next to interview.bob.mp4, belongs only to that one. The order among files of one stem is
    .TextGrid, .json, .tsv, .csv, .ctm, .vtt, .srt, .txt. A .json or .csv of motion that `ha2g export` wrote is not a
    transcript. Returns None if there is no transcript.

    Args:
        media: path of the audio, video or motion file of the recording, which need not exist.
        is_alone: whether no other recording is in the folder.
    """
    media = pathlib.Path(media)
    if not media.parent.is_dir():
        return None
    names = (path for path in media.parent.iterdir() if path.suffix.lower() in _PREFERENCE and path != media)
    files = sorted(
        (path for path in names if path.is_file() and not _is_motion(path)),
        key=lambda path: (_PREFERENCE.index(path.suffix.lower()), path.name),
    )
    # In other case, a file of another kind is the recording's sound, and one of the same kind is another recording.
    others = {
        path.stem
        for path in media.parent.iterdir()
        if path.suffix.lower() not in _PREFERENCE
        and (folded(path.stem) != folded(media.stem) or path.suffix.lower() == media.suffix.lower())
    } - {media.stem}
    stem = media.name
    while stem:
        start, own = folded(stem), {path: folded(path.stem) for path in files if path.stem not in others}
        of_stem = [path for path in files if path.stem == stem] or [path for path in own if own[path] == start]
        in_language = [
            path for path in own if own[path].startswith(start) and _LANGUAGE.fullmatch(own[path][len(start) :])
        ]
        if not of_stem and len({own[path] for path in in_language}) > 1:
            _say_languages(media, tuple(path.name for path in in_language))
        if of_stem or in_language:
            return (of_stem or in_language)[0]
        stem = stem.rpartition(".")[0]
    called_words = [path for path in files if path.stem == "words"]
    return called_words[0] if is_alone and len(called_words) == 1 else None


def _is_motion(path: pathlib.Path) -> bool:
    """Return whether a file begins like the motion that `ha2g export` writes, which is not a transcript."""
    with contextlib.suppress(OSError), path.open("rb") as file:
        return _MOTION.match(file.read(64)) is not None
    return False


def read_words(path: pathlib.Path) -> tuple[Word, ...]:
    """Read a transcript with times: TextGrid, SRT, VTT, a table, or JSON of the programs in `entries.PROGRAMS`.

    The content determines the format. A path such as `talk.vtt#Mary` selects the words of one speaker, or of one tier
    of a TextGrid. If a file has times only for lines or segments, these are divided among their words by letters.
    The words are in lower case without punctuation, in order of time, not overlapping, 0 <= start < end in seconds.

    Raises:
        UserError: the file cannot be read, or has no words, impossible times, or no times.
    """
    file, speaker = split_speaker(path)
    return parse_words(read_text(file), file, speaker)


def parse_words(text: str, file: pathlib.Path, speaker: str = "") -> tuple[Word, ...]:
    """Parse the text of a transcript of a file, see `read_words`.

    Raises:
        UserError: the text has no words, impossible times, or no times.
    """
    parse = _parser(text, file)
    if parse is None:
        raise UserError(
            f"{shown(file)} is a text without times; expected a transcript with times, or a text "
            "together with its audio"
        )
    return _words(parse(text, file), speaker, file)


def split_speaker(path: str | os.PathLike) -> tuple[pathlib.Path, str]:
    """Return the file and the speaker of a path, empty for all speakers; a file may have # in its own name."""
    file, _, speaker = os.fspath(path).rpartition("#")
    if file and speaker and pathlib.Path(file).is_file():
        return pathlib.Path(file), speaker
    return pathlib.Path(path), ""


def _parser(text: str, path: pathlib.Path) -> _Parse | None:
    """Return the parser of a transcript, None for a text without times."""
    suffix = path.suffix.lower()
    beginning = (parse for start, parse in _BY_BEGINNING.items() if re.match(start, text.lstrip()))
    if parse := next(beginning, parse_table if is_table(text) else _BY_SUFFIX.get(suffix)):
        return parse
    if suffix == ".txt" and (_MARKUP.match(text) or len(_CLOCK_LINE.findall(text)) > max(2, text.count("\n") // 4)):
        raise UserError(
            f"{shown(path)} has times or tags in a form that is not known; save it as SRT, VTT or TextGrid, or as the "
            "words alone"
        )
    if suffix != ".txt":
        raise UserError(
            f"{shown(path)} is not a transcript of a known format; expected one of .TextGrid .json .tsv .csv .vtt .srt"
        )
    return None


def _words(
    tiers: list[Tier], speaker: str, path: pathlib.Path, duration: float = math.inf, recorded: str | None = None
) -> tuple[Word, ...]:
    words = to_words(choose(tiers, speaker, path, duration, recorded), path)
    if not words:
        raise UserError(f"{shown(path)} has no words with times; expected a transcript of the recording")
    return words
