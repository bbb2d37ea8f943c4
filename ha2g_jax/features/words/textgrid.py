"""TextGrids of Praat, long, short and chronological, and the choice among tiers and speakers."""

import logging
import math
import pathlib
import re
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

from ha2g_jax.errors import UserError
from ha2g_jax.features.words.labels import spoken
from ha2g_jax.features.words.timing import Stretch
from ha2g_jax.files.reading import reason, shown

_logger = logging.getLogger(__name__)

# Praat reads texts in quotation marks, in which "" is a quotation mark, and free-standing numbers; the rest is comment.
_VALUE = re.compile(
    r'"(?P<text>[^"]*(?:""[^"]*)*)"|![^\n]*|(?<!\S)(?P<number>[-+]?[0-9][0-9.]*(?:[eE][-+]?[0-9]+)?)(?!\S)'
)

_CHRONOLOGICAL = '"Praat chronological TextGrid'
_WORD_NAMES = ("words", "word", "ort", "ort-mau", "orthography", "transcript", "transcription", "text")
# Words within a tier's name, such as "S1 - words" of the Montreal aligner.
_IS_WORDS = re.compile(r"\b(words?|ort)\b")
_IS_PHONES = re.compile(r"\b(phones?|phon|phonemes?|phonetic|segments?|mau|kan|syllables?|states?)\b")
_SILENCES = {"sil", "sp", "spn", "spl", "_"}
_BRACKETED = re.compile(r"<.*>|\[.*\]|\{.*\}", re.DOTALL)


class Tier(NamedTuple):
    """Stretches that belong together; formats without tiers have one without a name."""

    name: str
    stretches: list[Stretch]


def parse_textgrid(text: str, path: pathlib.Path) -> list[Tier]:
    """Parse the interval tiers of a file at `path`, as Praat reads them.

    Raises:
        UserError: the text is not a TextGrid in text form, or has fewer or more values than it declares.
    """
    values = _values(text)
    tiers = []
    try:
        if text.lstrip().startswith(_CHRONOLOGICAL):
            return _chronological(values)
        _, kind_of_file, _, _, count = _take(values, str, str, float, float, float)
        for _ in range(int(count)):
            kind, name, _, _, size = _take(values, str, str, float, float, float)
            entry = (float, float, str) if kind == "IntervalTier" else (float, str)
            stretches = []
            for found in range(int(size)):
                try:
                    *times, label = _take(values, *entry)
                except ValueError:
                    raise ValueError(f"declares {size:.0f} intervals but has {found}") from None
                stretches.append(Stretch(label, times[0], times[-1]))
            tiers += [Tier(name, stretches)] if kind == "IntervalTier" else []
        rest = [*values]
    except (ValueError, OverflowError) as error:
        problem = f"is a damaged TextGrid or none in text form ({reason(error)[:80]})"
        raise UserError(f"{shown(path)} {problem}; save it again from Praat, as text file") from error
    if kind_of_file != "TextGrid" or rest:
        problem = f"has {len(rest)} values more than it declares" if rest else f"has a {kind_of_file[:40]!r}"
        raise UserError(f"{shown(path)} {problem}; expected a TextGrid: save it again from Praat, as text file")
    return tiers


def _chronological(values: Iterator[str | float]) -> list[Tier]:
    """Return the interval tiers of a file in which entries of all tiers are in order of time, with a tier's number."""
    _, _, _, count = _take(values, str, float, float, float)
    heads = [_take(values, str, str, float, float) for _ in range(int(count))]
    tiers = [Tier(name, []) for _, name, _, _ in heads]
    while entry := _take(values, float, missing=True):
        index = int(entry[0]) - 1
        is_interval = index in range(len(heads)) and heads[index][0] == "IntervalTier"
        *times, label = _take(values, float, float, str) if is_interval else _take(values, float, str)
        if is_interval:
            tiers[index].stretches.append(Stretch(label, times[0], times[-1]))
    return [tier for tier, (kind, *_) in zip(tiers, heads, strict=True) if kind == "IntervalTier"]


def _values(text: str) -> Iterator[str | float]:
    for match in _VALUE.finditer(text):
        if match["text"] is not None:
            yield match["text"].replace('""', '"')
        elif match["number"]:
            yield float(match["number"])


def _take(values: Iterator[str | float], *kinds: type, missing: bool = False) -> list:
    taken = [value for _, value in zip(kinds, values, strict=False)]
    if [*map(type, taken)] != [*kinds] and (taken or not missing):
        raise ValueError(f"found {str(taken)[:40]}; expected {', '.join(kind.__name__ for kind in kinds)}")
    return taken


def choose(
    tiers: Sequence[Tier], speaker: str, path: pathlib.Path, duration: float = math.inf, recorded: str | None = None
) -> list[Stretch]:
    """Return what a speaker says, or by default what is said in the word tier, by all speakers; see `spoken`.

    `speaker` is the name of a tier, the part of it before or after `words`, or a name that the stretches have. The word
    tier is the one named words, word, ORT etc.; else one whose name contains such a word; else the tier with the most
    labels, except tiers of phones. A warning lists the names if there are several speakers and none is chosen, unless
    only one is `recorded`: then it is that one's words. Empty labels, `sil`, `sp`, `<...>`, `[...]` and `{...}` of
    tiers are silence.

    Raises:
        UserError: there is no tier of words, or no such speaker, or none of several is the one who is recorded.
    """
    if not tiers:
        return []
    if any(tier.name for tier in tiers):
        tiers = [Tier(tier.name, list(filter(_is_speech, tier.stretches))) for tier in tiers]
    wanted = (speaker or recorded or "").casefold()
    of_speaker = [tier for tier in tiers if wanted and wanted == tier.name.strip().casefold()]
    of_speaker = of_speaker or [tier for tier in tiers if wanted and wanted == _without_words(tier.name)]
    if of_speaker:
        return spoken(max((tier.stretches for tier in of_speaker), key=len), duration)
    names = [tier.name for tier in tiers]
    stretches = tiers[0].stretches if names == [""] else _word_tier(tiers, path, bool(speaker), recorded)
    stretches = spoken(stretches, duration)
    speakers = [*dict.fromkeys(one.speaker for one in stretches if one.speaker)]
    of_name = [one for one in stretches if one.speaker.casefold() == wanted]
    if speaker and not of_name:
        found = _listed(speakers or filter(None, names))
        raise UserError(f"{shown(path)} has no speaker {speaker[:40]!r}; expected one of: {found}")
    if wanted and of_name:
        return of_name
    if len(speakers) > 1:
        _report(f"{shown(path)} has several speakers ({_listed(speakers)})", "whose words are all read", recorded)
    return stretches


def _report(found: str, which: str, recorded: str | None) -> None:
    """Warn in the log that words are of several people; raise an error for a recording that is part of a corpus."""
    if recorded is None:
        _logger.warning("%s, %s; choose one by FILE#NAME", found, which)
        return
    raise UserError(
        f"{found}, and the recording is of {recorded[:40]!r}; leave the words of one in the file, give the "
        "recording's speaker the same name, or choose one for a single recording by --words FILE#NAME"
    )


def _is_speech(stretch: Stretch) -> bool:
    label = stretch.text.strip()
    return bool(label) and label.lower() not in _SILENCES and not _BRACKETED.fullmatch(label) and label[0] not in "!%"


def _without_words(name: str) -> str:
    return _IS_WORDS.sub("", name.casefold().replace("_", " ")).strip(" -:/|.()[]")


def _listed(names: Iterable[str]) -> str:
    return ", ".join(repr(name[:40]) for name in [*names][:8]) or "none"


def _word_tier(tiers: Sequence[Tier], path: pathlib.Path, is_chosen: bool, recorded: str | None) -> list[Stretch]:
    by_name: dict[str, Tier] = {}
    for tier in sorted(tiers, key=lambda tier: not tier.stretches):
        by_name.setdefault(tier.name.strip().lower(), tier)
    if named := [by_name[name] for name in _WORD_NAMES if name in by_name]:
        return next((tier.stretches for tier in named if tier.stretches), [])
    by_name = {name: tier for name, tier in by_name.items() if tier.stretches}
    alike = [tier for name, tier in by_name.items() if _IS_WORDS.search(name.replace("_", " "))]
    alike = alike or [tier for name, tier in by_name.items() if not _IS_PHONES.search(name)]
    names = _listed(tier.name for tier in (alike or tiers))
    if not alike:
        raise UserError(f"{shown(path)} has no interval tier with words (tiers: {names}); name the tier `words`")
    longest = max(alike, key=lambda tier: len(tier.stretches))
    if len(alike) > 1 and not is_chosen:
        which = f"of which {longest.name[:40]!r} is read"
        _report(f"{shown(path)} has several tiers of words ({names})", which, recorded)
    return longest.stretches
