"""Parser of the word tier of a Praat TextGrid in the long or the short format."""

import pathlib
import re

from ha2g_jax.errors import UserError, require
from ha2g_jax.features.words.timing import Stretch
from ha2g_jax.files.reading import reason, shown

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
