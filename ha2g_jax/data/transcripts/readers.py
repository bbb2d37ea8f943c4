"""Any transcript with times as words: the format goes by the file's suffix and, between relatives, by its contents."""

import pathlib

from ha2g_jax.data.transcripts import contents, json_words, subtitles, table, textgrid, timing
from ha2g_jax.errors import UserError
from ha2g_jax.features.text import Word

FORMATS = {
    ".textgrid": textgrid.parse_textgrid,
    ".json": json_words.parse_json,
    ".tsv": table.parse_table,
    ".csv": table.parse_table,
    ".vtt": subtitles.parse_vtt,
    ".srt": subtitles.parse_srt,
}


def read_words(path: pathlib.Path) -> tuple[Word, ...]:
    """The words of a transcript with times: TextGrid, Gentle, Whisper or whisperX JSON, SRT, VTT, TSV or CSV.

    Where a file gives times only to lines or segments, their words share them by letters.

    Args:
        path: the file.

    Returns:
        Words in lower case without punctuation, in order of time, not overlapping, 0 <= start < end in seconds.

    Raises:
        UserError: the file cannot be read, holds no words or impossible times, or gives no times at all.
    """
    path = pathlib.Path(path)
    suffix = path.suffix.lower()
    if suffix == ".txt":
        raise UserError(f"{path} is a text without times; its words must be aligned with the sound of the recording")
    if suffix not in FORMATS:
        raise UserError(
            f"{path} is no transcript that can be read; expected one of .TextGrid .json .tsv .csv .vtt .srt"
        )
    text = contents.read_text(path)
    parse = FORMATS[suffix]
    if suffix in (".vtt", ".srt"):  # often named like one another
        parse = subtitles.parse_vtt if text.lstrip().startswith("WEBVTT") else subtitles.parse_srt
    words = timing.to_words(parse(text, path), path)
    if not words:
        raise UserError(f"{path} holds no words with times; expected a transcript of the recording")
    return words
