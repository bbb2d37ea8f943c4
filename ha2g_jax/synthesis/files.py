"""Speech file in, motion file and video out."""

import dataclasses
import pathlib
import sys
from collections.abc import Mapping, Sequence

import numpy as np
from tqdm import tqdm

from ha2g_jax.data import transcripts
from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import read_audio
from ha2g_jax.features.text import Word
from ha2g_jax.files.whole_file import whole_file
from ha2g_jax.motion import control
from ha2g_jax.motion.video import write_video
from ha2g_jax.synthesis.model import Model, load
from ha2g_jax.synthesis.seed_pose import SeedPose


def generate_files(
    speech: str | pathlib.Path,
    out: str | pathlib.Path | None = None,
    checkpoint: str | pathlib.Path = "demo",
    *,
    speaker: str | None = None,
    reference_images: str | pathlib.Path | Sequence[str | pathlib.Path] | None = None,
    style_seed: int | None = None,
    style: Mapping[str, float] | None = None,
    seed: int = 0,
    seed_pose: SeedPose | None = None,
    fps: float | None = None,
    smoothing: float = 0.0,
    controls: control.Controls = control.NEUTRAL,
    words: pathlib.Path | None = None,
    size: int | tuple[int, int] = 720,
) -> tuple[pathlib.Path, pathlib.Path]:
    """Writes the motion (`.npz`) and a video of the figure with the sound (`.mp4`): both, or neither.

    Args:
        speech: a file with sound.
        out: the name of both files, with or without `.npz` or `.mp4`, or a folder to put them in; by default
            they lie beside the speech, with `_gestures` after its name.
        checkpoint: see `load`.
        speaker, reference_images, style_seed, style, seed, seed_pose, fps, smoothing, controls: see `Model.generate`.
        words: a transcript of the speech for a model that reads words, by default the one beside the speech. HA2G needs
            none.
        size: width and height of the video in pixels, one number for both.

    Returns:
        The paths of the `.npz` and the `.mp4`.

    Raises:
        UserError: as `load` and `Model.generate`, or the place cannot be written.
    """
    speech = pathlib.Path(speech)
    npz, mp4 = out_paths(speech, out)
    audio = read_audio(speech)
    model = load(checkpoint)
    spoken = _read_words(model, speech, audio, words)
    # Opened before the work, so that a place that cannot be written is noticed in time.
    with whole_file(npz) as temporary_npz, whole_file(mp4) as temporary_mp4:
        motion = model.generate(
            audio,
            speaker=speaker,
            reference_images=reference_images,
            style_seed=style_seed,
            style=style,
            seed=seed,
            seed_pose=seed_pose,
            fps=fps,
            smoothing=smoothing,
            controls=controls,
            words=spoken,
        )
        motion = dataclasses.replace(motion, meta=motion.meta | {"speech": speech.name})
        motion.save(temporary_npz)
        write_video(temporary_mp4, motion, audio, size=size)
    return npz, mp4


def _read_words(model: Model, speech: pathlib.Path, audio: np.ndarray, words: pathlib.Path | None) -> tuple[Word, ...]:
    """The words of the speech, none for a model that hears the sound alone or where there is no transcript."""
    if not model.reads_words:
        return ()
    words = words or transcripts.find(speech)
    if words is None:
        tqdm.write(
            f"{model.config.method} reads words, and {speech} has no transcript beside it: going on without "
            "(--words names one)",
            file=sys.stderr,
        )
        return ()
    return transcripts.words_of(audio, words, recognise=None)


def out_paths(speech: pathlib.Path, out: str | pathlib.Path | None) -> tuple[pathlib.Path, pathlib.Path]:
    """Where `generate_files` writes the `.npz` and the `.mp4`.

    Raises:
        UserError: one of them would overwrite the speech.
    """
    if out is None or pathlib.Path(out).is_dir():
        stem = (speech.parent if out is None else pathlib.Path(out)) / f"{speech.stem}_gestures"
    else:
        out = pathlib.Path(out)
        stem = out.with_suffix("") if out.suffix in (".npz", ".mp4") else out
    npz, mp4 = (stem.with_name(stem.name + suffix) for suffix in (".npz", ".mp4"))
    if speech.resolve() in (npz.resolve(), mp4.resolve()):
        raise UserError(f"the result would overwrite {speech}; choose another name with --out")
    return npz, mp4
