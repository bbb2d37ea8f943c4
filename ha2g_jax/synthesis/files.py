"""Generate the files of a motion from a speech file: the motion itself, videos, pages and files of other programs."""

import contextlib
import pathlib
import sys
from typing import Unpack

import numpy as np
from tqdm import tqdm

from ha2g_jax.data import transcripts
from ha2g_jax.errors import UserError
from ha2g_jax.features.text import Word
from ha2g_jax.files.reading import reading, shown
from ha2g_jax.files.whole_file import whole_file
from ha2g_jax.motion import formats
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.video import check_size, write_video
from ha2g_jax.progress import stage
from ha2g_jax.synthesis.model import Audio, Model, Options, load, read_speech
from ha2g_jax.viewer.page import write_page

_VIDEO, _PAGE = ".mp4", ".html"
SUFFIXES = (*formats.SUFFIXES, _VIDEO, _PAGE)
_WITHOUT_SUFFIX = (".npz", _VIDEO)


def generate_files(
    speech: str | pathlib.Path,
    out: str | pathlib.Path | None = None,
    checkpoint: str | pathlib.Path = "demo",
    *,
    words: pathlib.Path | None = None,
    size: int | tuple[int, int] = 720,
    **options: Unpack[Options],
) -> tuple[pathlib.Path, ...]:
    """Generate motion for a speech file and write it.

    The suffix of `out` is the format: one of `motion.formats.SUFFIXES`, `.mp4` for a video with the sound,
    or `.html` for a page of the viewer with it. Without a suffix the motion (`.npz`) and the video (`.mp4`) are
    written, both or neither. What the work is and how long it has taken is shown on stderr.

    Args:
        speech: path of a file with sound.
        out: file to write; a name without a suffix for the motion and the video; or a folder for these two. By default
            they are in the folder of the speech, and have its name with `_gestures` appended.
        checkpoint: model, see `load`.
        words: path of a transcript of the speech, for a model that reads words; by default a transcript beside the
            speech is used. HA2G needs none.
        size: width and height of the video in pixels, one number for both.
        options: keyword arguments of `Model.generate`.

    Returns:
        The paths of the files.

    Raises:
        UserError: as `out_paths`, `load` and `Model.generate`, or a file cannot be written.
    """
    speech = pathlib.Path(speech)
    paths = out_paths(speech, out)
    check_size((size, size) if isinstance(size, int) else size)
    if words is not None:
        with reading(words, "a transcript"), words.open("rb"):
            pass  # a path that cannot be read is noticed before the work
    with stage("reading the speech"):
        audio = read_speech(speech)
    with stage("loading the model"):
        model = load(checkpoint)
    spoken = _read_words(model, speech, audio.samples, words)
    with contextlib.ExitStack() as stack:
        # The files are opened before the work, so that a path that cannot be written is noticed early.
        temporary = [stack.enter_context(whole_file(path)) for path in paths]
        # A program is compiled for the length of the speech, which takes most of the time of a short one.
        with stage(f"compiling for {audio.duration:.1f} s of speech and generating the motion"):
            motion = model.generate(audio, words=spoken, **options)
        for path in temporary:
            _write(path, motion, audio, spoken, size)
    return paths


def _write(
    path: pathlib.Path, motion: Motion, audio: Audio, words: tuple[Word, ...], size: int | tuple[int, int]
) -> None:
    """Write a motion in the format of the suffix of the path, with the sound if the format has sound."""
    suffix = path.suffix.lower()
    if suffix == _VIDEO:
        write_video(path, motion, audio.samples, size=size)
        return
    with stage(f"writing {suffix}"):
        if suffix == _PAGE:
            name = shown(pathlib.Path(audio.name or "").stem)
            write_page(path, {name: motion}, audio.samples, words=words)
        else:
            formats.export(motion, path)


def _read_words(model: Model, speech: pathlib.Path, audio: np.ndarray, words: pathlib.Path | None) -> tuple[Word, ...]:
    """Return the words of the speech; () if the model reads no words or there is no transcript."""
    if not model.reads_words:
        if words is not None:
            tqdm.write(f"{model.config.method} reads no words: {shown(words)} is not used", file=sys.stderr)
        return ()
    words = words or transcripts.find(speech)
    if words is None:
        tqdm.write(
            f"{model.config.method} reads words, but {shown(speech)} has no transcript beside it: continuing without "
            "words; name a transcript with --words",
            file=sys.stderr,
        )
        return ()
    return transcripts.words_of(audio, words, recognise=None)


def out_paths(speech: pathlib.Path, out: str | pathlib.Path | None) -> tuple[pathlib.Path, ...]:
    """Return the paths of the files that `generate_files` writes.

    Args:
        speech: path of the speech.
        out: see `generate_files`.

    Raises:
        UserError: the suffix of `out` is not one of `SUFFIXES`, or a file would overwrite the speech.
    """
    if out is None or pathlib.Path(out).is_dir():
        out = (speech.parent if out is None else pathlib.Path(out)) / f"{speech.stem}_gestures"
        is_stem = True
    else:
        out = pathlib.Path(out)
        is_stem = not out.suffix
    if not is_stem and out.suffix.lower() not in SUFFIXES:
        raise UserError(
            f"cannot write {shown(out.name)}: {shown(out.suffix)}; expected one of {', '.join(SUFFIXES)}, or a name "
            "without a suffix for .npz and .mp4"
        )
    paths = tuple(out.with_name(out.name + suffix) for suffix in _WITHOUT_SUFFIX) if is_stem else (out,)
    if speech.resolve() in [path.resolve() for path in paths]:
        raise UserError(f"the result would overwrite {shown(speech)}; choose another name with --out")
    return paths
