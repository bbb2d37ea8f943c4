"""Cues, which request a gesture at a time, on a word or now."""

import math
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from ha2g_jax.errors import UserError, check_number
from ha2g_jax.features.text import Word
from ha2g_jax.files.reading import shown
from ha2g_jax.motion.cues.catalogue import GESTURES, NAMES, Keyframes, keyframes
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.resample import num_frames, resample
from ha2g_jax.skeleton import Skeleton

CLIP = "clip:"
MAX_SECONDS = 360_000.0  # a hundred hours
_CLIP_EASE = 0.4  # seconds before and after a clip


class Cue(NamedTuple):
    """A request for a gesture.

    Attributes:
        name: "nod", "count:3", "point:left" or another one of `catalogue.NAMES`, or "clip:FILE" for a file of motion.
        time: time in seconds at which the stroke peaks; with a word, the time from which the word is searched; in a
            stream, None means as soon as possible.
        word: word of the transcript on whose beginning the stroke peaks.
        clip: motion of a clip, as `reading.read_clip` reads it.
    """

    name: str
    time: float | None = None
    word: str | None = None
    clip: Motion | None = None


def check_name(name: str, *, has_files: bool = True) -> str:
    """Return the name of a gesture in the form that `keyframes_of` takes.

    Raises:
        UserError: there is no such gesture, or it is a clip although `has_files` is False.
    """
    name = name.strip()
    if name.startswith(CLIP) and name != CLIP and has_files:
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


def keyframes_of(cue: Cue, skeleton: Skeleton, fps: float) -> Keyframes:
    """Return the keyframes of the gesture of a cue; those of a clip have a frame rate, and the middle is its peak.

    A clip uses the whole body; the motion eases to its first pose before it, and from its last pose after it.

    Raises:
        UserError: there is no such gesture, or the motion of a clip has not been read or has another skeleton.
    """
    name = check_name(cue.name)
    if not name.startswith(CLIP):
        return keyframes(skeleton, name)
    motion = cue.clip
    if motion is None:
        raise UserError(f"the cue {shown(name)} has no motion; read it with ha2g_jax.motion.cues.reading.read_clip")
    if motion.skeleton.name != skeleton.name:
        raise UserError(f"the cue {shown(name)} is read for {motion.skeleton.name}; read it for {skeleton.name}")
    count = num_frames(motion.num_frames / motion.fps, fps)
    directions = resample(motion.directions, motion.fps, fps, count)
    times = (np.arange(count) - count // 2) / fps
    start, end = times[0], times[-1]
    weight_times = np.array([start - _CLIP_EASE, start, 0, end, end + _CLIP_EASE])
    return Keyframes.of_motion(skeleton, times, directions, weight_times)


def check_cue(cue: Cue | str) -> Cue:
    """Return a cue, or the cue with a name, whose name has the form that `keyframes_of` takes.

    Raises:
        UserError: the value is not a cue, there is no such gesture, or the time is not a number of seconds.
    """
    cue = Cue(cue) if isinstance(cue, str) else cue
    if not (isinstance(cue, Cue) and isinstance(cue.name, str) and isinstance(cue.word, str | None)):
        raise UserError(f"a cue is {cue!r}; give a Cue, such as Cue('nod', 1.5)")
    name = check_name(cue.name)
    message = f"the time of the cue {shown(name)} is {cue.time!r}; expected seconds from 0 to {MAX_SECONDS:g}"
    time = None if cue.time is None else check_number(cue.time, 0, MAX_SECONDS, message)
    return cue._replace(name=name, time=time)


def place(cues: Iterable[Cue | str], words: Sequence[Word], duration: float = math.inf) -> tuple[Cue, ...]:
    """Return cues with the times of their words, which peak within a motion of a duration in seconds.

    A cue on a word peaks at the beginning of the first such word, from the cue's time on.

    Raises:
        UserError: a cue is not valid, has neither a time nor a word, or its word is not spoken; or its time is after
            the end of the motion.
    """
    placed = []
    for cue in map(check_cue, cues):
        if cue.word is not None:
            starts = [it.start for it in words if it.text == cue.word.lower() and it.start >= (cue.time or 0)]
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
    """Return cues as JSON values, without what is None, and without the motion of clips."""
    names = ("cue", "time", "word")
    return [{name: value for name, value in zip(names, cue, strict=False) if value is not None} for cue in cues]
