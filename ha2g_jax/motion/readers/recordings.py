"""Recordings of motion capture: finding motion files with their audio, words and speaker."""

import os
import pathlib
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.features import words as transcripts
from ha2g_jax.features.audio import SAMPLE_RATE, read_audio
from ha2g_jax.features.media import SOUND_SUFFIXES, sound_after_images
from ha2g_jax.features.text import Word
from ha2g_jax.features.words.timing import inside
from ha2g_jax.files.reading import files_below, folded, reading, resolved, shown
from ha2g_jax.limits import MAX_SOUND_SECONDS
from ha2g_jax.motion.readers import is_motion
from ha2g_jax.motion.readers.bvh import USUAL_RATES
from ha2g_jax.motion.readers.smplx_arrays import is_embody

# In order of preference, if several files lie beside a motion file.
AUDIO_SUFFIXES = (*SOUND_SUFFIXES, ".mp4", ".mov", ".mkv", ".webm", ".avi")

_EMBODY_AUDIO = "separated_audio"
_MAX_DIFFERENCE = 0.5  # seconds between the ends of motion and audio without a warning
_MAX_ERROR = 0.015  # error of the length at another frame rate, as a fraction of the length of the sound
_MOST_CUT = 1.0  # seconds by which the sound of a public collection may be longer than its motion
_MULTIPLES = range(2, 11)
_MIN_FRACTION = 0.5  # minimum length of the shorter of motion and audio, as a fraction of the longer one


class MotionRecording(NamedTuple):
    """A motion file, alone in its folder or not, and the files that belong to it, None where they lie beside it."""

    path: pathlib.Path
    name: str
    speaker: str
    audio: pathlib.Path | None
    words: pathlib.Path | None
    is_alone: bool


def find_recordings(
    src: pathlib.Path,
    suffixes: Sequence[str],
    *,
    speaker: str | None = None,
    audio: str | os.PathLike | None = None,
    words: str | os.PathLike | None = None,
) -> list[MotionRecording]:
    """Find the motion files in a folder and its subfolders, in order of their paths, or the one file.

    A recording has the name of its file, or its path if two files in different folders have the same name. By default a
    speaker has the name of the folder of the file, or that of the file if `src` is one.

    Args:
        suffixes: of motion files, such as ".bvh", in any letter case; of files of one name the first is the motion.
        audio, words: audio file and transcript of the only motion file.

    Raises:
        UserError: there is no such file, or audio or words are given for several files.
    """
    kinds = f"file of motion ({', '.join(suffixes)})"
    with reading(src, f"a {kinds} or a folder of them"):
        if not src.exists():
            raise UserError(f"nothing at {shown(src)}; give a {kinds} or a folder of them")
        if src.is_file():
            paths, root = [src], src.parent
        else:
            found = [path for path in files_below(src) if path.suffix.lower() in suffixes and is_motion(path)]
            ranks = {path: suffixes.index(path.suffix.lower()) for path in found if not path.name.startswith(".")}
            best = {path.with_suffix(""): rank for path, rank in sorted(ranks.items(), key=lambda item: -item[1])}
            paths, root = sorted(path for path, rank in ranks.items() if best[path.with_suffix("")] == rank), src
    if not paths:
        raise UserError(f"no {kinds} in {shown(src)} or below it; give one or a folder of them")
    if len(paths) > 1 and (audio or words):
        raise UserError(f"{shown(src)} holds {len(paths)} files of motion; give --audio and --words for one file only")
    names = [shown(path.stem) for path in paths]
    if len(set(names)) < len(names):
        names = [shown("_".join(path.relative_to(root).with_suffix("").parts)) for path in paths]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise UserError(f"{shown(src)} holds two recordings that would both be called {twice}; rename one")
    is_one = src.is_file()
    folders = [path.parent for path in paths]
    speakers = [speaker or shown(path.stem if is_one else resolved(path.parent).name) for path in paths]
    sound, text = (None if file is None else pathlib.Path(file) for file in (audio, words))
    return [
        MotionRecording(path, name, own, sound, text, folders.count(path.parent) == 1)
        for path, name, own in zip(paths, names, speakers, strict=True)
    ]


def find_embody(root: pathlib.Path, speaker: str | None = None) -> list[MotionRecording]:
    """Find the people of the captures of Embody 3D in a folder, each of whom is a recording.

    Args:
        root: a folder of captures, such as `datasets/emotions`, one of a person in it, or a folder above them.
        speaker: name of the speaker; by default the person.

    Returns:
        The recordings in order of their paths, none if the folder has another layout. Words lie beside the audio.
    """
    found = []
    for path in sorted(path for path in files_below(root) if is_embody(path)):
        person = path.parent.parent
        audio = person / _EMBODY_AUDIO / f"{path.stem}.wav"
        words = transcripts.find(audio, is_alone=False)
        name = shown(f"{path.stem}--{person.name}")
        given = audio if audio.is_file() else None
        found.append(MotionRecording(path, name, speaker or shown(person.name), given, words, is_alone=False))
    return found


def read_speech(recording: MotionRecording, *, with_words: bool) -> tuple[np.ndarray, tuple[Word, ...] | None]:
    """Read the audio and the words of a recording.

    Both lie in the folder of the motion file and have its stem, or its stem up to a dot; see `transcripts.find`.

    Motion that belongs to a video begins with its first image: sound that starts later has silence before it, and
    sound that starts earlier is cut.

    Returns:
        (samples,) float32 at 16 kHz, and the words in seconds from the start, None if there is no transcript.

    Raises:
        UserError: there is no audio, a required transcript is missing, or a file cannot be read.
    """
    name, stem = shown(recording.path), shown(recording.path.stem)
    path = recording.audio or find_audio(recording.path)
    if path is None:
        raise UserError(
            f"{shown(recording.path)} has no audio; put {recording.path.stem}.wav beside it or give it (--audio)"
        )
    transcript = recording.words or transcripts.find(recording.path, is_alone=recording.is_alone)
    if transcript is None and with_words:
        raise UserError(
            f"{name} has no transcript; put {stem}.TextGrid, .json, .srt, .vtt or .tsv beside it, or allow it to "
            "have none (--no-words)"
        )
    audio, late = read_audio(path), min(sound_after_images(path), MAX_SOUND_SECONDS)
    words = None
    if transcript is not None:
        words = transcripts.words_of(audio, transcript, recognise=None, media=path, speaker=recording.speaker)
    samples = round(late * SAMPLE_RATE)
    audio = np.pad(audio, (max(samples, 0), 0))[max(-samples, 0) :]
    if words is not None and late:
        moved = (word._replace(start=word.start + late, end=word.end + late) for word in words)
        words = inside(moved, len(audio) / SAMPLE_RATE)
    return audio, words


def compare_lengths(path: pathlib.Path, motion: float, fps: float, audio: np.ndarray) -> str | None:
    """Compare the length in seconds of the motion of a file, at a frame rate, with that of its audio at 16 kHz.

    The longer one will be cut.

    Returns:
        A warning if the lengths differ by more than half a second, else None.

    Raises:
        UserError: one is less than half as long as the other, so that they cannot belong together.
    """
    sound = len(audio) / SAMPLE_RATE
    lengths = f"{shown(path)} has {motion:.2f} s of motion and {sound:.2f} s of audio"
    rate = other_rate(motion, fps, sound)
    if min(motion, sound) < _MIN_FRACTION * max(motion, sound):
        raise UserError(f"{lengths}, which do not belong together{rate}; give the audio of this motion")
    if abs(motion - sound) <= _MAX_DIFFERENCE:
        return None
    longer = "motion" if motion > sound else "audio"
    return f"{lengths}; cut to the shorter, without the last {abs(motion - sound):.1f} s of {longer}{rate}"


def other_rate(motion: float, fps: float | None, sound: float) -> str:
    """Return the end of a message that names the frame rate at which a motion would be as long as its sound.

    Args:
        motion, sound: lengths in seconds, the former at `fps` frames per second, None where its rate is beyond doubt.

    Returns:
        "" if no usual rate, and no whole multiple or fraction of the rate, fits.
    """
    if fps is None:
        return ""
    whole = [*(fps * number for number in _MULTIPLES), *(fps / number for number in _MULTIPLES)]
    for rates in (whole, USUAL_RATES):
        rate = min(rates, key=lambda rate: abs(motion * fps / rate - sound))
        if abs(motion * fps / rate - sound) <= min(_MOST_CUT, _MAX_ERROR * sound):
            break
    else:
        return ""
    if abs(rate / fps - 1) < 2 * _MAX_ERROR:
        return ""
    return (
        f": the lengths are as {motion / sound:.3g} to 1, so that {rate:.5g} frames per second may be right in place "
        f"of {fps:.5g} (--source-fps {rate:.5g})"
    )


def find_audio(path: pathlib.Path) -> pathlib.Path | None:
    """Find the sound in the folder of a motion file, with its stem or its stem up to a dot; None if there is none."""
    beside = {folded(file.name): file for file in sorted(path.parent.iterdir(), reverse=True) if file.is_file()}
    stem = path.stem
    while stem:
        for suffix in AUDIO_SUFFIXES:
            if found := beside.get(folded(f"{stem}{suffix}")):
                return found
        stem = stem.rpartition(".")[0]
    return None
