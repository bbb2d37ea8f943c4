"""Lookup of the transcript that lies beside a recording."""

import pathlib
import re

# Formats with a time for each word come first, a text without times last.
_PREFERENCE = (".textgrid", ".json", ".tsv", ".csv", ".vtt", ".srt", ".txt")
_LANGUAGE = re.compile(r"\.[a-z]{2,3}(?:-[a-zA-Z]{2,8})?")


def find(media: pathlib.Path, *, is_alone: bool = True) -> pathlib.Path | None:
    """Find the transcript of a recording in its folder.

    The first match wins: a file with the recording's stem; with the stem and a language, as in `talk.en.vtt`; with the
    stem cut at its last dot, and so on; the only file called `words.*`, if no other recording is in the folder. The
    order among files of one stem is .TextGrid, .json, .tsv, .csv, .vtt, .srt, .txt.

    Args:
        media: path of the audio, video or motion file of the recording, which need not exist.
        is_alone: whether no other recording is in the folder.

    Returns:
        Path of the transcript, None if there is none.
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
