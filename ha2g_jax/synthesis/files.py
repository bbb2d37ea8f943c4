"""Generate a motion file and a video from a speech file."""

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
from ha2g_jax.motion.video import write_video
from ha2g_jax.synthesis.model import Model, Options, load, read_speech


def generate_files(
    speech: str | pathlib.Path,
    out: str | pathlib.Path | None = None,
    checkpoint: str | pathlib.Path = "demo",
    *,
    words: pathlib.Path | None = None,
    size: int | tuple[int, int] = 720,
    **options: Unpack[Options],
) -> tuple[pathlib.Path, pathlib.Path]:
    """Generate motion for a speech file; write it (`.npz`) and a video of the figure with the sound (`.mp4`).

    Either both files are written or neither.

    Args:
        speech: path of a file with sound.
        out: name of both files, with or without `.npz` or `.mp4`, or a folder for them; by default the folder of the
            speech, and its name with `_gestures` appended.
        checkpoint: model, see `load`.
        words: path of a transcript of the speech, for a model that reads words; by default a transcript beside the
            speech is used. HA2G needs none.
        size: width and height of the video in pixels, one number for both.
        options: keyword arguments of `Model.generate`.

    Returns:
        The paths of the `.npz` and the `.mp4`.

    Raises:
        UserError: as `load` and `Model.generate`, or a file cannot be written.
    """
    speech = pathlib.Path(speech)
    npz, mp4 = out_paths(speech, out)
    if words is not None:
        with reading(words, "a transcript"), words.open("rb"):
            pass  # a path that cannot be read is noticed before the work
    audio = read_speech(speech)
    model = load(checkpoint)
    spoken = _read_words(model, speech, audio.samples, words)
    # The files are opened before the work, so that a path that cannot be written is noticed early.
    with whole_file(npz) as temporary_npz, whole_file(mp4) as temporary_mp4:
        motion = model.generate(audio, words=spoken, **options)
        motion.save(temporary_npz)
        write_video(temporary_mp4, motion, audio.samples, size=size)
    return npz, mp4


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


def out_paths(speech: pathlib.Path, out: str | pathlib.Path | None) -> tuple[pathlib.Path, pathlib.Path]:
    """Return the paths of the `.npz` and the `.mp4` that `generate_files` writes.

    Args:
        speech: path of the speech.
        out: see `generate_files`.

    Raises:
        UserError: a file would overwrite the speech.
    """
    if out is None or pathlib.Path(out).is_dir():
        stem = (speech.parent if out is None else pathlib.Path(out)) / f"{speech.stem}_gestures"
    else:
        out = pathlib.Path(out)
        stem = out.with_suffix("") if out.suffix in (".npz", ".mp4") else out
    npz, mp4 = (stem.with_name(stem.name + suffix) for suffix in (".npz", ".mp4"))
    if speech.resolve() in (npz.resolve(), mp4.resolve()):
        raise UserError(f"the result would overwrite {shown(speech)}; choose another name with --out")
    return npz, mp4
