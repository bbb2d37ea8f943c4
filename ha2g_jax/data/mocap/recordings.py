"""Which sound, words and speaker belong to a file of motion, and whether they are as long as it."""

import pathlib
from typing import NamedTuple

import numpy as np

from ha2g_jax.data import transcripts
from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import SAMPLE_RATE, read_audio
from ha2g_jax.features.text import Word

# In the order of preference where several lie beside a file.
AUDIO_SUFFIXES = (
    *(".wav", ".flac", ".mp3", ".m4a", ".aac", ".ogg", ".opus", ".wma", ".aiff", ".aif"),
    *(".mp4", ".mov", ".mkv", ".webm", ".avi"),
)

_MAX_DIFFERENCE = 0.5  # seconds between the ends of motion and sound that need no mention
_MIN_SHARE = 0.5  # of the longer one that the shorter one must have


class Source(NamedTuple):
    """A file of motion and what belongs to it.

    Attributes:
        path: the motion.
        talk: name of the recording, unique among its like.
        speaker: name of the speaker.
        audio: the sound, None to look for it beside the motion.
        words: the transcript, None to look for it beside the motion.
        is_alone: whether no other motion lies in its folder.
    """

    path: pathlib.Path
    talk: str
    speaker: str
    audio: pathlib.Path | None
    words: pathlib.Path | None
    is_alone: bool


def find_sources(
    src: pathlib.Path,
    suffix: str,
    *,
    audio: pathlib.Path | None = None,
    words: pathlib.Path | None = None,
    speaker: str | None = None,
) -> list[Source]:
    """The files of motion in a folder and all below it, in order of their paths, or the one file.

    A talk is called as its file; where two files in different folders have one name, as the path. A speaker is called
    as the folder where `src` has subfolders, else as the file.

    Args:
        src: a file, or a folder.
        suffix: of files of motion, such as ".bvh", in any letter case.
        audio, words: sound and transcript of the only file.
        speaker: name of the speaker of all files.

    Raises:
        UserError: there is no such file, or audio or words are given for several.
    """
    if not src.exists():
        raise UserError(f"nothing at {src}; give a {suffix} file or a folder of them")
    if src.is_file():
        paths, root = [src], src.parent
    else:
        found = (path for path in src.rglob("*") if path.suffix.lower() == suffix and path.is_file())
        paths, root = sorted(path for path in found if not path.name.startswith(".")), src
    if not paths:
        raise UserError(f"no {suffix} file in {src} or below it; give a {suffix} file or a folder of them")
    if len(paths) > 1 and (audio or words):
        raise UserError(f"{src} holds {len(paths)} {suffix} files; give sound and words by option for one file only")
    talks = [path.stem for path in paths]
    if len(set(talks)) < len(talks):
        talks = ["_".join(path.relative_to(root).with_suffix("").parts) for path in paths]
    if len(set(talks)) < len(talks):
        twice = next(talk for talk in talks if talks.count(talk) > 1)
        raise UserError(f"{src} holds two recordings that would both be called {twice}; rename one")
    in_folders = any(path.parent != root for path in paths)
    folders = [path.parent for path in paths]
    return [
        Source(path, talk, speaker or (path.parent.name if in_folders else path.stem), audio, words, is_alone)
        for path, talk, is_alone in zip(paths, talks, (folders.count(folder) == 1 for folder in folders), strict=True)
    ]


def read_speech(source: Source, *, with_words: bool) -> tuple[np.ndarray, tuple[Word, ...] | None]:
    """Sound and words of a recording.

    Sound and words lie in the motion's folder and have its stem, or its stem up to a dot; see `transcripts.find`.

    Args:
        source: the recording.
        with_words: whether it must have a transcript.

    Returns:
        (samples,) float32 at 16 kHz, and the words within it in seconds; None where there is no transcript.

    Raises:
        UserError: there is no sound, or no transcript where one is wanted, or one of them cannot be read.
    """
    path = source.audio or _find_audio(source.path)
    if path is None:
        raise UserError(f"{source.path} has no sound beside it; put {source.path.stem}.wav there or give it (--audio)")
    transcript = source.words or _find_words(source)
    if transcript is None and with_words:
        raise UserError(
            f"{source.path} has no transcript beside it; put {source.path.stem}.TextGrid, .json, .srt, .vtt or .tsv "
            "there, or do without words (--no-words)"
        )
    audio = read_audio(path)
    if transcript is None:
        return audio, None
    return audio, transcripts.words_of(audio, transcript, recognise=None)


def compare_lengths(source: Source, motion: float, audio: np.ndarray) -> str | None:
    """A sentence where motion, in seconds, and sound differ by more than half a second; the longer one will be cut.

    Raises:
        UserError: one is less than half as long as the other, so that they cannot belong together.
    """
    sound = len(audio) / SAMPLE_RATE
    lengths = f"{source.path} has {motion:.2f} s of motion and {sound:.2f} s of sound"
    if min(motion, sound) < _MIN_SHARE * max(motion, sound):
        raise UserError(f"{lengths}, which do not belong together; give the sound of this motion")
    return f"{lengths}; cut to the shorter" if abs(motion - sound) > _MAX_DIFFERENCE else None


def _find_audio(path: pathlib.Path) -> pathlib.Path | None:
    beside = {file.name.lower(): file for file in sorted(path.parent.iterdir(), reverse=True) if file.is_file()}
    stem = path.stem
    while stem:
        for suffix in AUDIO_SUFFIXES:
            if found := beside.get(f"{stem}{suffix}".lower()):
                return found
        stem = stem.rpartition(".")[0]
    return None


def _find_words(source: Source) -> pathlib.Path | None:
    found = transcripts.find(source.path)
    # A file called words.* says not whose they are, where there are several recordings.
    return None if found is not None and found.stem == "words" and not source.is_alone else found
