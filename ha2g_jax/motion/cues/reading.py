"""Reading of cues from text and files, and of the motion of clips."""

import itertools
import json
import os
import pathlib
import re
from collections.abc import Container

from ha2g_jax.errors import UserError
from ha2g_jax.features import words as transcripts
from ha2g_jax.features.media import sound_delay
from ha2g_jax.features.words.encodings import read_text
from ha2g_jax.features.words.labels import spoken
from ha2g_jax.features.words.subtitles import parse_subtitles
from ha2g_jax.features.words.timing import MAX_SECONDS
from ha2g_jax.files.reading import naming, parse_json, shown
from ha2g_jax.motion.cues.cue import CLIP, Cue, check_cue, check_name
from ha2g_jax.skeleton import Skeleton

SUFFIXES = (".srt", ".vtt", ".jsonl")
_EXPECTED = '{"cue": "nod", "time": 1.2}'
# A note of a subtitle, such as [Music] or [door slams], is no marker.
_MARKER = re.compile(r"\[(clip:[^\]\n]{1,200}|[a-z]+(?::[a-z0-9]+)*)\]")
_PLACEHOLDER = "ha2gcue{}"
_INLINE_TIME = re.compile(r"<[0-9][0-9:.]*>")
_GAP = 0.25  # seconds between a cue in a subtitle and a word that is not its own


def read_cue(text: str, *, has_files: bool = False) -> Cue:
    """Parse a cue from JSON such as {"cue": "count:3", "time": 1.2} or {"cue": "nod", "word": "three"}.

    Args:
        has_files: whether the cue may be a clip, which reads a file of this machine.

    Raises:
        UserError: the text has another form, or there is no such gesture.
    """
    try:
        value = parse_json(text)
    except ValueError:
        value = None
    if not isinstance(value, dict) or not isinstance(value.get("cue"), str):
        raise UserError(f"{shown(text.strip())[:60]!r} is no cue; expected JSON such as {_EXPECTED}")
    if others := value.keys() - {"cue", "time", "word"}:
        raise UserError(f"a cue has no {shown(min(others))[:60]!r}; expected cue, and time or word")
    name, time, word = check_name(value["cue"], has_files=has_files), value.get("time"), value.get("word")
    if word is not None:
        spelled = transcripts.split_words(word) if isinstance(word, str) else []
        if len(spelled) != 1:
            raise UserError(f"the word of the cue {shown(name)} is {shown(json.dumps(word))[:60]}; expected one word")
        word = spelled[0]
    return check_cue(Cue(name, time, word))


def read_cues(path: str | os.PathLike, media: pathlib.Path | None = None) -> tuple[Cue, ...]:
    """Read the cues of a file: of lines of JSON (`.jsonl`, see `read_cue`), or of subtitles (`.srt`, `.vtt`).

    In subtitles a cue stands in brackets before its word, as in "there are [count:3] three of them", or else after it;
    one that is alone in a subtitle peaks at its beginning. Times in subtitles count from the start of the
    recording `media`, and the times of the cues from the start of its sound, which may be later.

    Raises:
        UserError: the file cannot be read, is of another kind, or has no cues or a cue that there is not.
    """
    path = pathlib.Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise UserError(f"{shown(path)} is no file of cues; expected one of {', '.join(SUFFIXES)}")
    text = read_text(path, "a file of cues")
    cues = _of_lines(text, path) if path.suffix.lower() == ".jsonl" else _of_subtitles(text, path, media)
    if not cues:
        raise UserError(f"{shown(path)} has no cues; write lines such as {_EXPECTED}, or [nod] before a word")
    return cues


def _of_lines(text: str, path: pathlib.Path) -> tuple[Cue, ...]:
    cues = []
    for number, line in enumerate(text.split("\n"), start=1):
        if line.strip():
            with naming(f"{path}, line {number}"):
                cues.append(read_cue(line, has_files=True))
                if cues[-1].time is None and cues[-1].word is None:
                    raise UserError(f"the cue {cues[-1].name} has neither a time nor a word; give one of them")
    return tuple(cues)


def _of_subtitles(text: str, path: pathlib.Path, media: pathlib.Path | None) -> tuple[Cue, ...]:
    with naming(path):
        markers = {marker: check_name(marker) for marker in dict.fromkeys(_MARKER.findall(text))}
    if not markers:
        return ()
    placeholders = {_PLACEHOLDER.format(number): marker for number, marker in enumerate(markers)}
    spelled = text
    for placeholder, marker in placeholders.items():
        spelled, text = (each.replace(f"[{marker}]", new) for each, new in ((spelled, f" {placeholder} "), (text, " ")))
    found = transcripts.parse_words(spelled, path)
    places = [index for index, word in enumerate(found) if word.text not in placeholders]
    words = transcripts.parse_words(text, path) if places else ()
    if [found[index].text for index in places] != [word.text for word in words]:
        raise UserError(f"{shown(path)} has cues that are at no word; put each one right before a word")
    if lost := placeholders.keys() - {word.text for word in found}:
        raise UserError(f"{shown(path)} has the cue [{placeholders[min(lost)]}] where nothing is spoken; move it")
    alone = [] if _INLINE_TIME.search(spelled) else _alone(spelled, path, placeholders)
    delay = 0.0 if media is None else sound_delay(media)
    starts = dict(zip(places, (word.start for word in words), strict=True))
    breaks = [index for index in range(1, len(found)) if found[index].start - found[index - 1].end >= _GAP]
    cues = []
    for first, end in itertools.pairwise([0, *breaks, len(found)]):
        for index in range(first, end):
            if (text := found[index].text) in placeholders:
                near = [place for place in (*range(index, end), *range(index, first - 1, -1)) if place in starts]
                # Beyond other subtitles, which have only cues, a word may be far away.
                if near and any(found[index].end <= start <= found[near[0]].start for start, _, _ in alone):
                    near = [place for place in near if place < index] or near
                own = [start for start, end, cues in alone if text in cues and start <= found[index].start < end]
                start = own[0] if own else starts[near[0]] if near else found[index].start
                cues.append(Cue(markers[placeholders[text]], max(start - delay, 0.0)))
    return tuple(cues)


def _alone(text: str, path: pathlib.Path, placeholders: Container[str]) -> list[tuple[float, float, list[str]]]:
    """Return start, end and cues, as placeholders, of the subtitles that have cues and no word."""
    parts = [part for tier in parse_subtitles(text, path) for part in spoken(tier.stretches, MAX_SECONDS)]
    return [
        (part.start or 0.0, part.end or 0.0, cues)
        for part in parts
        if (cues := part.text.split()) and all(word in placeholders for word in cues)
    ]


def read_clip(cue: Cue | str, skeleton: Skeleton) -> Cue:
    """Read the motion of a clip, a cue whose name is "clip:FILE", for a skeleton; other cues stay as they are.

    Raises:
        UserError: the file cannot be read as motion of the skeleton.
    """
    cue = cue if isinstance(cue, Cue) else Cue(cue)
    if not cue.name.startswith(CLIP):
        return cue
    from ha2g_jax.motion.readers import read_motion  # which takes half a second to import

    return cue._replace(clip=read_motion(cue.name.removeprefix(CLIP), skeleton=skeleton.name))
