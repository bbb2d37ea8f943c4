"""The transcript that lies beside a recording."""

import pathlib
import re

# Those with a time for each word come first, a text without times last.
_PREFERENCE = (".textgrid", ".json", ".tsv", ".csv", ".vtt", ".srt", ".txt")
_LANGUAGE = re.compile(r"\.[a-z]{2,3}(?:-[a-zA-Z]{2,8})?")


def find(media: pathlib.Path) -> pathlib.Path | None:
    """The transcript of a recording, looked for in its folder.

    Rule, first match wins: the recording's stem; the stem with a language, as in `talk.en.vtt`; the stem cut at its
    last dot, and so on; the only file called `words.*`. Among files of one stem: .TextGrid, .json, .tsv, .csv, .vtt,
    .srt, .txt.

    Args:
        media: sound, video or motion of the recording; need not exist.

    Returns:
        The file, None where there is none.
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
    return called_words[0] if len(called_words) == 1 else None
