"""A trained model, and what can be asked of it."""

import dataclasses
import math
import pathlib
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import numpy as np

from ha2g_jax import __version__
from ha2g_jax.checkpoint import model_folder
from ha2g_jax.checkpoint.assets import Assets
from ha2g_jax.data.speech import prepare
from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import SAMPLE_RATE, check_samples, read_audio
from ha2g_jax.features.text import Word
from ha2g_jax.layers.resnet_se import Features
from ha2g_jax.methods.ha2g.model import HA2G
from ha2g_jax.methods.task import Task
from ha2g_jax.motion import control
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.resample import num_frames, resample
from ha2g_jax.motion.smoothing import check_width, smooth
from ha2g_jax.motion.windows import ease_borders, join_windows, num_windows
from ha2g_jax.synthesis.scan import encode_windows, infer_windows
from ha2g_jax.synthesis.seed_pose import SeedPose, read_seed_pose, start_from
from ha2g_jax.synthesis.style import choose_style

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
        style: Mapping[str, float] | None = None,
        seed: int = 0,
        seed_pose: SeedPose | None = None,
        fps: float | None = None,
        smoothing: float = 0.0,
        controls: control.Controls = control.NEUTRAL,
        words: Sequence[Word] = (),
    ) -> Motion:
        """Gestures for speech.

        The style comes from a speaker of the training data, or is a mixture of several, or from images of a person, or
        is drawn from the prior N(0, I) with `style_seed`; without any of them it is drawn with `seed`. The first window
        starts from `seed_pose`, else from one of the calm poses stored with the model, which `seed` picks. The same
        input and seed give the same motion.

        Args:
            speech: a file with sound, or (samples,) float mono samples at 16 kHz.
            speaker: a name in `assets.speakers`.
            reference_images: one or more pictures of a person, like the frames the model was trained with.
            style_seed: seed of a style.
            style: shares by name in `assets.speakers`; what they sum to is 1, and the identities are interpolated.
            seed: seed of everything random.
            seed_pose: a motion, or its `.npz`, that this one goes on from: frame 0 shows where its last M frames began;
                or a pose (bones, 3) to start from.
            fps: frames per second of the result, the model's by default; other rates are interpolated on the sphere.
            smoothing: seconds of the window that poses are averaged over, see `motion.smoothing`; 0 for none.
            controls: what else is asked of the motion, see `motion.control`.
            words: of the speech, in order of time, for a model that `reads_words`; HA2G does without.

        Returns:
            Motion of exactly round(duration x fps) frames, at least 1.

        Raises:
            UserError: the speech, the style, a seed, the seed pose, the frame rate or a control cannot be used.
        """
        f_id, described = choose_style(self, speaker, reference_images, style_seed, seed, style=style)
        fps = _check_fps(fps, self.fps)
        audio = read_audio(speech) if isinstance(speech, str | pathlib.Path) else _check_array(speech)
        duration = len(audio) / SAMPLE_RATE
        skeleton, overlap = self.assets.skeleton, self.task.num_seed_frames
        control.check(controls, skeleton, duration)
        check_width(smoothing)
        start = start_name = None
        if seed_pose is not None:
            start, start_name = read_seed_pose(seed_pose, skeleton, self.fps, overlap)
        directions = _join(self, audio, f_id, seed, words, start)
        directions = directions if start is None else start_from(directions, start)
        directions = ease_borders(directions, self.task.num_frames, overlap, from_start=start is not None)
        frames = num_frames(duration, fps)
        directions = directions[:frames] if fps == self.fps else resample(directions, self.fps, fps, frames)
        directions = control.apply(skeleton, smooth(directions, fps, smoothing), fps, controls)
        asked = {"seed_pose": start_name, "smoothing": smoothing, "controls": control.describe(controls)}
        meta = {
            "version": __version__,
            "model": self.config.name,
            "checkpoint": self.assets.hash,
            "speech": pathlib.Path(speech).name if isinstance(speech, str | pathlib.Path) else None,
            "duration": duration,
            "style": described,
            "seed": seed,
        }
        return Motion.from_directions(skeleton, directions, fps, meta | {name: it for name, it in asked.items() if it})


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
    return _join(model, audio, f_id, seed, words, start)[: _num_frames(model, audio)]


def _join(
    model: Model, audio: np.ndarray, f_id: np.ndarray, seed: int, words: Sequence[Word], start: np.ndarray | None
) -> np.ndarray:
    """All frames of the windows that cover the audio, joined: as many as `generate_directions` gives, or more."""
    bank = model.assets.seed_poses
    pose = bank[np.random.default_rng(seed).integers(len(bank))] if start is None else start
    windows = infer_windows(model.task, model.variables, _encode_windows(model, audio, words), f_id, pose)
    if not np.isfinite(windows).all():
        raise UserError(f"model {model.assets.hash} gives values that are not finite; train or export it again")
    return join_windows(windows, model.task.num_seed_frames)


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
