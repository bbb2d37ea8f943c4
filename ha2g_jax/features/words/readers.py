"""Reader of transcripts with times; the format is determined by the suffix, and that of subtitles by the contents."""

import pathlib

from ha2g_jax.errors import UserError
from ha2g_jax.features.text import Word
from ha2g_jax.features.words import contents, json_words, subtitles, table, textgrid, timing
from ha2g_jax.files.reading import shown

FORMATS = {
    ".textgrid": textgrid.parse_textgrid,
    ".json": json_words.parse_json,
    ".tsv": table.parse_table,
    ".csv": table.parse_table,
    ".vtt": subtitles.parse_vtt,
    ".srt": subtitles.parse_srt,
}


def read_words(path: pathlib.Path) -> tuple[Word, ...]:
    """Read a transcript with times: TextGrid, Gentle, Whisper or whisperX JSON, SRT, VTT, TSV or CSV.

    If a file has times only for lines or segments, these are divided among their words by letters.

    Args:
        path: path of the transcript.

    Returns:
        Words in lower case without punctuation, in order of time, not overlapping, 0 <= start < end in seconds.

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
    if suffix not in FORMATS:
        raise UserError(
            f"{shown(path)} is not a transcript of a known format; expected one of .TextGrid .json .tsv .csv .vtt .srt"
        )
    text = contents.read_text(path)
    parse = FORMATS[suffix]
    if suffix in (".vtt", ".srt"):  # often one has the suffix of the other
        parse = subtitles.parse_vtt if text.lstrip().startswith("WEBVTT") else subtitles.parse_srt
    words = timing.to_words(parse(text, path), path)
    if not words:
        raise UserError(f"{shown(path)} has no words with times; expected a transcript of the recording")
    return words
