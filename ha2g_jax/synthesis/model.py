"""A trained model, and what can be asked of it."""

import dataclasses
import math
import pathlib
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from PIL import Image, ImageOps

from ha2g_jax import __version__
from ha2g_jax.audio import SAMPLE_RATE, check_samples, read_audio
from ha2g_jax.data.speech import prepare
from ha2g_jax.data.windows import resize_frames
from ha2g_jax.errors import UserError
from ha2g_jax.models import HA2G, Features
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.resample import num_frames, resample
from ha2g_jax.motion.windows import join_windows, num_windows
from ha2g_jax.synthesis.scan import encode_windows, infer_windows
from ha2g_jax.text import Word
from ha2g_jax.train import model_folder
from ha2g_jax.train.assets import Assets
from ha2g_jax.train.task import Task

MIN_FPS, MAX_FPS = 1, 240


@dataclasses.dataclass(frozen=True, eq=False)
class Model:
    """A trained generator, ready to use; see `load`.

    Attributes:
        task: the modules and the sizes they work with.
        variables: parameters and BatchNorm statistics of the generator.
        assets: skeleton, vocabulary, styles of the training speakers, and a bank of start poses.
        config: what it was trained with.
    """

    task: Task
    variables: dict[str, Any]
    assets: Assets
    config: Any

    @property
    def reads_words(self) -> bool:
        """Whether the words of the speech change the motion."""
        return bool({"words", "plain_words"} & set(self.task.generator.inputs))

    @property
    def has_audio_levels(self) -> bool:
        """Whether the model hears speech on HA2G's three levels, so that `encode_features` can give them."""
        return isinstance(self.task.generator, HA2G)

    @property
    def fps(self) -> int:
        """Frames per second that the model thinks in."""
        return self.config.data.fps

    def generate(
        self,
        speech: str | pathlib.Path | np.ndarray,
        *,
        speaker: str | None = None,
        reference_images: str | pathlib.Path | Sequence[str | pathlib.Path] | None = None,
        style_seed: int | None = None,
        seed: int = 0,
        fps: float | None = None,
        words: Sequence[Word] = (),
    ) -> Motion:
        """Gestures for speech.

        The style comes from a speaker of the training data, or from images of a person, or is drawn from the prior
        N(0, I) with `style_seed`; without any of them it is drawn with `seed`. The first window starts from one of
        the calm poses stored with the model, which `seed` picks. The same input and seed give the same motion.

        Args:
            speech: a file with sound, or (samples,) float mono samples at 16 kHz.
            speaker: a name in `assets.speakers`.
            reference_images: one or more pictures of a person, like the frames the model was trained with.
            style_seed: seed of a style.
            seed: seed of everything random.
            fps: frames per second of the result, the model's by default; other rates are interpolated on the sphere.
            words: of the speech, in order of time, for a model that `reads_words`; HA2G does without.

        Returns:
            Motion of exactly round(duration x fps) frames, at least 1.

        Raises:
            UserError: the speech, the style, a seed or the frame rate cannot be used.
        """
        f_id, style = choose_style(self, speaker, reference_images, style_seed, seed)
        fps = _check_fps(fps, self.fps)
        audio = read_audio(speech) if isinstance(speech, str | pathlib.Path) else _check_array(speech)
        directions = generate_directions(self, audio, f_id, seed, words=words)
        duration = len(audio) / SAMPLE_RATE
        if fps != self.fps:
            directions = resample(directions, self.fps, fps, num_frames(duration, fps))
        meta = {
            "version": __version__,
            "model": self.config.name,
            "checkpoint": self.assets.hash,
            "speech": pathlib.Path(speech).name if isinstance(speech, str | pathlib.Path) else None,
            "duration": duration,
            "style": style,
            "seed": seed,
        }
        return Motion.from_directions(self.assets.skeleton, directions, fps, meta)


def load(spec: str | pathlib.Path = "demo") -> Model:
    """A trained model.

    Args:
        spec: "demo" for the model that comes with the package, a folder that `ha2g export-model` wrote, or a workdir
            of `ha2g train`.

    Raises:
        UserError: there is no model, it is damaged, or it is a pose auto-encoder.
    """
    loaded = model_folder.load(spec)
    if not hasattr(loaded.task.generator, "infer"):
        raise UserError(f"the model in {spec} is of {loaded.config.method}, which generates no motion; name another")
    return Model(loaded.task, jax.device_put(loaded.variables), loaded.assets, loaded.config)


def choose_style(
    model: Model,
    speaker: str | None = None,
    reference_images: str | pathlib.Path | Sequence[str | pathlib.Path] | None = None,
    style_seed: int | None = None,
    seed: int = 0,
) -> tuple[np.ndarray, dict[str, Any]]:
    """The identity f_id (18,) that `Model.generate` takes for these arguments, and a description of it for the record.

    Raises:
        UserError: more than one source, an unknown speaker, an image that cannot be read, or a negative seed.
    """
    if sum(source is not None for source in (speaker, reference_images, style_seed)) > 1:
        raise UserError("the style has more than one source; give a speaker, reference images or a style seed")
    if min(seed, style_seed or 0) < 0:
        raise UserError(f"seed {min(seed, style_seed or 0)} is negative; give 0 or more")
    if speaker is not None:
        if speaker not in model.assets.speakers:
            known = ", ".join(model.assets.speakers)
            expected = f"expected one of: {known}" if known else "it knows none"
            raise UserError(f"no speaker {speaker!r} in the model; {expected}")
        return np.asarray(model.assets.speakers[speaker], np.float32), {"kind": "speaker", "speaker": speaker}
    if reference_images is not None:
        if isinstance(reference_images, str | pathlib.Path):
            reference_images = [reference_images]
        names = [pathlib.Path(path).name for path in reference_images]
        return _encode_images(model, reference_images), {"kind": "images", "images": names}
    style_seed = seed if style_seed is None else style_seed
    style_dim = model.task.generator.style_dim
    f_id = np.random.default_rng(style_seed).standard_normal(style_dim, np.float32)
    return f_id, {"kind": "prior", "seed": style_seed}


def generate_directions(
    model: Model,
    audio: np.ndarray,
    f_id: np.ndarray,
    seed: int = 0,
    *,
    words: Sequence[Word] = (),
    start: np.ndarray | None = None,
) -> np.ndarray:
    """Direction vectors for samples that have been checked, at the model's own frame rate.

    Args:
        audio: (samples,) float32 at 16 kHz.
        f_id: (style_dim,) identity.
        seed: picks the start pose.
        words: of the audio, for a model that reads them.
        start: (M, bones, 3) unit vectors, the start pose in place of one that is picked.

    Returns:
        (T, bones, 3) float32 unit vectors, T = max(1, round(duration x fps)).

    Raises:
        UserError: the model's numbers are broken.
    """
    bank = model.assets.seed_poses
    pose = bank[np.random.default_rng(seed).integers(len(bank))] if start is None else start
    windows = infer_windows(model.task, model.variables, _encode_windows(model, audio, words), f_id, pose)
    if not np.isfinite(windows).all():
        raise UserError(f"model {model.assets.hash} gives values that are not finite; train or export it again")
    return join_windows(windows, model.task.num_seed_frames)[: _num_frames(model, audio)]


def encode_features(model: Model, audio: np.ndarray) -> Features:
    """Frozen audio features of a clip, for probes: f_low, f_mid and f_high, each (T, 32) at the model's frame rate.

    Where two windows overlap, each gives the frames that are farther from its border.
    """
    overlap = model.task.num_seed_frames
    keep = slice(overlap // 2, overlap // 2 + model.task.num_frames - overlap)

    def join(windows: np.ndarray) -> np.ndarray:
        middle = windows[:, keep].reshape(-1, windows.shape[-1])
        return np.concatenate([windows[0, : keep.start], middle, windows[-1, keep.stop :]])[: _num_frames(model, audio)]

    return jax.tree.map(join, _encode_windows(model, audio, ()))


def _num_frames(model: Model, audio: np.ndarray) -> int:
    return num_frames(len(audio) / SAMPLE_RATE, model.fps)


def _encode_windows(model: Model, audio: np.ndarray, words: Sequence[Word]) -> Any:
    count = num_windows(_num_frames(model, audio), model.task.num_frames, model.task.num_seed_frames)
    speech = prepare(audio, words, model.task.generator.inputs)
    return encode_windows(model.task, model.variables, speech, model.assets.vocabulary, count, model.fps)


def _encode_images(model: Model, paths: Sequence[str | pathlib.Path]) -> np.ndarray:
    """The mean of f_id (18,) for pictures of any size, cut to a square about the middle."""
    if model.task.identity_input != "frames":
        names = ", ".join(model.assets.speakers)
        known = f"knows speakers by name, not by images; expected one of: {names}" if names else "knows no speakers"
        raise UserError(f"this model {known}")
    if not paths:
        raise UserError("an empty list of reference images; give one or more pictures")
    images = []
    for path in paths:
        try:
            with Image.open(path) as image:
                picture = ImageOps.exif_transpose(image).convert("RGB")
        except (OSError, ValueError, Image.DecompressionBombError) as error:
            raise UserError(f"{path} cannot be read as an image; expected a PNG or JPEG of a person") from error
        side = min(picture.size)
        square = np.asarray(ImageOps.fit(picture, (side, side)))
        images.append(resize_frames(square[None], model.task.image_size))
    frames = jnp.asarray(np.concatenate(images))[None]
    outputs: Any = model.task.generator.apply(model.variables, frames, train=False, method="encode_identity")
    mean, _ = outputs
    return np.asarray(mean[0])


def _check_fps(fps: float | None, default: float) -> float:
    fps = default if fps is None else fps
    if not (math.isfinite(fps) and MIN_FPS <= fps <= MAX_FPS):
        raise UserError(f"{fps} frames per second; expected {MIN_FPS} to {MAX_FPS}")
    return fps


def _check_array(audio: np.ndarray) -> np.ndarray:
    audio = np.asarray(audio)
    if audio.ndim != 1 or not np.issubdtype(audio.dtype, np.floating):
        raise UserError(f"speech is an array of {audio.dtype}, shape {audio.shape}; expected float mono at 16 kHz")
    return check_samples(audio.astype(np.float32), SAMPLE_RATE, "the speech")
