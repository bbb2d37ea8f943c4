"""Cues, which ask for a gesture at a time, on a word or now, and their reading from text and files."""

import itertools
import json
import math
import os
import pathlib
import re
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.features import words as transcripts
from ha2g_jax.features.text import Word
from ha2g_jax.features.words.encodings import read_text
from ha2g_jax.files.reading import naming, parse_json, shown
from ha2g_jax.motion.cues.catalogue import GESTURES, NAMES, Keyframes, keyframes
from ha2g_jax.motion.resample import num_frames, resample
from ha2g_jax.skeleton import Skeleton

MAX_SECONDS = 360_000.0  # a hundred hours
SUFFIXES = (".srt", ".vtt", ".jsonl")
_CLIP = "clip:"
_EXPECTED = '{"cue": "nod", "time": 1.2}'
# A note of a subtitle, such as [Music] or [door slams], is no marker.
_MARKER = re.compile(r"\[(clip:[^\]\n]{1,200}|[a-z]+(?::[a-z0-9]+)*)\]")
_PLACEHOLDER = "ha2gcue{}"
_GAP = 0.25  # seconds between a cue in a subtitle and a word that is not its own
_CLIP_EASE = 0.4  # seconds before and after a clip


class Cue(NamedTuple):
    """A gesture that is asked for.

    Attributes:
        name: "nod", "count:3", "point:left" or another one of `catalogue.NAMES`, or "clip:FILE" for a file of motion.
        time: seconds of the motion at which the stroke peaks; with a word, from which on the word is looked for; in a
            stream, None is as soon as possible.
        word: word of the transcript on whose beginning the stroke peaks.
    """

    name: str
    time: float | None = None
    word: str | None = None


def check_name(name: str, *, has_files: bool = True) -> str:
    """Return the name of a gesture as `keyframes_of` takes it.

    Raises:
        UserError: there is no such gesture, or it is a clip although `has_files` is False.
    """
    name = name.strip()
    if name.startswith(_CLIP) and name != _CLIP and has_files:
        return name
    if (right := name.removesuffix(":right")) in GESTURES and f"{right}:left" in NAMES:
        return right
    if name not in NAMES:
        raise UserError(f"no cue {shown(name)[:60]!r}; expected {_known(has_files)}")
    return name


def _known(has_files: bool) -> str:
    values: dict[str, list[str]] = {}
    for name in GESTURES:
        base, *value = name.split(":")
        values.setdefault(base, []).extend(value)
    known = [base + ":" * bool(of_base) + "|".join(of_base) for base, of_base in values.items()]
    return ", ".join([*known, *["clip:FILE"] * has_files]) + "; with :left for the left arm"


def keyframes_of(name: str, skeleton: Skeleton, fps: float) -> Keyframes:
    """Return the keyframes of a gesture, or of a clip at a frame rate, whose middle is its peak.

    A clip uses the whole body; the motion eases to its first pose before it, and from its last one after it.

    Raises:
        UserError: there is no such gesture, or a file of motion cannot be read.
    """
    name = check_name(name)
    if not name.startswith(_CLIP):
        return keyframes(skeleton, name)
    from ha2g_jax.motion.readers import read_motion  # which takes half a second to import

    motion = read_motion(name.removeprefix(_CLIP), skeleton=skeleton.name)
    count = num_frames(motion.num_frames / motion.fps, fps)
    directions = resample(motion.directions, motion.fps, fps, count)
    times = (np.arange(count) - count // 2) / fps
    start, end = times[0], times[-1]
    weight_times = np.array([start - _CLIP_EASE, start, 0, end, end + _CLIP_EASE])
    return Keyframes.of_motion(skeleton, times, directions, weight_times)


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
    if word is not None and not (isinstance(word, str) and len(transcripts.split_words(word)) == 1):
        raise UserError(f"the word of the cue {shown(name)} is {shown(json.dumps(word))[:60]}; expected one word")
    return check_cue(Cue(name, time, word))


def check_cue(cue: Cue) -> Cue:
    """Return a cue whose name is as `keyframes_of` takes it.

    Raises:
        UserError: there is no such gesture, or the time is not a number of seconds.
    """
    name = check_name(cue.name)
    is_number = isinstance(cue.time, int | float) and not isinstance(cue.time, bool)
    if cue.time is not None and not (is_number and 0 <= cue.time <= MAX_SECONDS):
        raise UserError(f"the time of the cue {shown(name)} is {cue.time!r}; expected seconds from 0 on")
    return cue._replace(name=name)


def read_cues(path: str | os.PathLike) -> tuple[Cue, ...]:
    """Read the cues of a file: of lines of JSON (`.jsonl`, see `read_cue`), or of subtitles (`.srt`, `.vtt`).

    In subtitles a cue stands in brackets before its word, as in "there are [count:3] three of them", or else after it;
    one that is alone in a subtitle peaks at its beginning.

    Raises:
        UserError: the file cannot be read, is of another kind, or has no cues or a cue that there is not.
    """
    path = pathlib.Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise UserError(f"{shown(path)} is no file of cues; expected one of {', '.join(SUFFIXES)}")
    text = read_text(path)
    cues = _of_lines(text, path) if path.suffix.lower() == ".jsonl" else _of_subtitles(text, path)
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


def _of_subtitles(text: str, path: pathlib.Path) -> tuple[Cue, ...]:
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
    starts = dict(zip(places, (word.start for word in words), strict=True))
    breaks = [index for index in range(1, len(found)) if found[index].start - found[index - 1].end >= _GAP]
    cues = []
    for first, end in itertools.pairwise([0, *breaks, len(found)]):
        for index in range(first, end):
            if (text := found[index].text) in placeholders:
                near = [place for place in (*range(index, end), *range(index, first - 1, -1)) if place in starts]
                cues.append(Cue(markers[placeholders[text]], starts[near[0]] if near else found[index].start))
    return tuple(cues)


def place(cues: Iterable[Cue], words: Sequence[Word], duration: float = math.inf) -> tuple[Cue, ...]:
    """Return cues with the times of their words, which peak within a motion of a duration in seconds.

    A cue on a word peaks at the beginning of the first such word, from the cue's time on.

    Raises:
        UserError: a cue is not valid, has neither a time nor a word, or its word is not spoken; or its time is after
            the end of the motion.
    """
    placed = []
    for cue in map(check_cue, cues):
        if cue.word is not None:
            spoken = transcripts.split_words(cue.word)
            starts = [word.start for word in words if [word.text] == spoken and word.start >= (cue.time or 0)]
            if not starts:
                after = f" from {cue.time:g} s on" if cue.time else ""
                raise UserError(
                    f"the word {shown(cue.word)[:60]!r} of the cue {shown(cue.name)} is not spoken{after}; give a word "
                    f"of the transcript, which has {len(words)}"
                )
            cue = cue._replace(time=starts[0])
        if cue.time is None:
            raise UserError(f"the cue {shown(cue.name)} has neither a time nor a word; give one of them")
        if cue.time > duration:
            raise UserError(
                f"a cue at {cue.time:g} s, after the end of the motion at {duration:g} s; give a time in it"
            )
        placed.append(cue)
    return tuple(placed)


def describe(cues: Iterable[Cue]) -> list[dict[str, Any]]:
    """Return cues as JSON values, without what is None."""
    names = ("cue", "time", "word")
    return [{name: value for name, value in zip(names, cue, strict=True) if value is not None} for cue in cues]
