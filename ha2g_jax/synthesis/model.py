"""A trained model that generates motion from speech."""

import dataclasses
import importlib.metadata
import math
import pathlib
from collections.abc import Sequence
from typing import Any, TypedDict

import jax
import numpy as np

from ha2g_jax.checkpoint import model_folder
from ha2g_jax.checkpoint.assets import Assets
from ha2g_jax.config import Config
from ha2g_jax.data.speech import prepare
from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.features.text import Word
from ha2g_jax.layers.resnet_se import Features
from ha2g_jax.limits import MAX_FPS, MIN_FPS
from ha2g_jax.methods import METHODS
from ha2g_jax.methods.method import Spec, Variables
from ha2g_jax.motion import control
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.resample import num_frames, resample
from ha2g_jax.motion.smoothing import check_width, smooth
from ha2g_jax.motion.windows import ease_borders, join_windows, num_windows
from ha2g_jax.synthesis.live import Stream
from ha2g_jax.synthesis.scan import encode_windows, sample_windows
from ha2g_jax.synthesis.seed_pose import SeedPose, read_seed_pose, start_from
from ha2g_jax.synthesis.speech import Speech, read_speech
from ha2g_jax.synthesis.style import FROM_PRIOR, Style, choose_style


class Options(TypedDict, total=False):
    """Keyword arguments of `Model.generate`, except `words`."""

    style: Style
    seed: int
    seed_pose: SeedPose | None
    fps: float | None
    smoothing: float
    controls: control.Controls


@dataclasses.dataclass(frozen=True, eq=False)
class Model:
    """A trained generator, see `load`.

    Attributes:
        spec: networks and sizes.
        variables: parameters and BatchNorm statistics of the generator.
        assets: skeleton, vocabulary, styles of the training speakers, and calm seed poses.
        config: settings that the networks are built from.
    """

    spec: Spec
    variables: Variables
    assets: Assets
    config: Config

    @property
    def reads_words(self) -> bool:
        """Whether the words of the speech change the motion."""
        return bool({"words", "plain_words"} & set(self.spec.inputs))

    @property
    def has_audio_levels(self) -> bool:
        """Whether the model has the three audio levels of HA2G, which `encode_features` returns."""
        return self.spec.method == "ha2g"

    @property
    def fps(self) -> int:
        """Frames per second of the poses that the generator samples."""
        return self.spec.fps

    def generate(
        self,
        speech: Speech,
        *,
        style: Style = FROM_PRIOR,
        seed: int = 0,
        seed_pose: SeedPose | None = None,
        fps: float | None = None,
        smoothing: float = 0.0,
        controls: control.Controls = control.NEUTRAL,
        words: Sequence[Word] = (),
    ) -> Motion:
        """Generate gestures for speech; the same arguments give the same motion.

        Args:
            speech: path of a file with sound, (samples,) float mono samples at 16 kHz, or the result of `read_speech`.
            style: requested style; by default it is drawn from the prior with `seed`.
            seed: seed of all random choices.
            seed_pose: motion, or the path of its `.npz`, that this motion continues: frame 0 is the first of the last M
                frames of that motion; or a pose (bones, 3) to start from. By default `seed` selects one of the calm
                poses stored with the model.
            fps: frames per second of the result, by default those of the model; other rates are interpolated.
            smoothing: length in seconds of the window over which poses are averaged, see `motion.smoothing`; 0 for no
                smoothing.
            controls: controls of the motion, see `motion.control`.
            words: words of the speech, in order of time, for a model that `reads_words`; HA2G needs none.

        Returns:
            Motion of exactly round(duration x fps) frames, at least 1.

        Raises:
            UserError: the speech, the style, a seed, the seed pose, the frame rate or a control cannot be used.
        """
        f_id, described = choose_style(self.spec, self.variables, self.assets, style, seed)
        fps = self.fps if fps is None else _check_fps(fps)
        audio = read_speech(speech)
        skeleton, overlap = self.assets.skeleton, self.spec.num_seed_frames
        control.check(controls, skeleton, audio.duration)
        check_width(smoothing)
        start = start_name = None
        if seed_pose is not None:
            start, start_name = read_seed_pose(seed_pose, skeleton, self.fps, overlap)
        directions = _join(self, audio.samples, f_id, seed, words, start)
        directions = directions if start is None else start_from(directions, start)
        directions = ease_borders(directions, self.spec.num_frames, overlap, from_start=start is not None)
        frames = num_frames(audio.duration, fps)
        directions = directions[:frames] if fps == self.fps else resample(directions, self.fps, fps, frames)
        directions = control.apply(skeleton, smooth(directions, fps, smoothing), fps, controls)
        asked = {"seed_pose": start_name, "smoothing": smoothing, "controls": control.describe(controls)}
        meta = {
            "version": importlib.metadata.version("ha2g-jax"),
            "model": self.config.name,
            "checkpoint": self.assets.hash,
            "speech": audio.name,
            "duration": audio.duration,
            "style": described,
            "seed": seed,
        }
        return Motion.from_directions(skeleton, directions, fps, meta | {name: it for name, it in asked.items() if it})

    def stream(
        self,
        *,
        look_ahead: int = 3,
        hop: int = 1,
        style: Style = FROM_PRIOR,
        seed: int = 0,
        controls: control.Controls = control.NEUTRAL,
        reference: float | None = None,
    ) -> Stream:
        """Begin a motion that follows speech while it arrives; the generator is compiled before this returns.

        Args:
            look_ahead: frames of speech that are heard beyond the last new frame, 0 to N. More of them give gestures
                that fit the speech better, and later; use a model that was trained with `data.lookahead`.
            hop: frames that are generated in one run, 1 to N - 2 M, or N - M. A greater hop needs less computation.
            style: requested style; by default it is drawn from the prior with `seed`.
            seed: seed of all random choices.
            controls: energy, extent, handedness and mirror.
            reference: mel power of 0 dB; by default a running level, see `features.running_mel`.

        Returns:
            The stream, whose `feed` takes samples and returns frames.

        Raises:
            UserError: the model reads more than a mel spectrogram, or an argument cannot be used.
        """
        return Stream(
            self.spec,
            self.variables,
            self.assets,
            look_ahead=look_ahead,
            hop=hop,
            style=style,
            seed=seed,
            controls=controls,
            reference=reference,
        )

    def check_options(
        self,
        *,
        style: Style = FROM_PRIOR,
        seed: int = 0,
        seed_pose: SeedPose | None = None,
        fps: float | None = None,
        smoothing: float = 0.0,
        controls: control.Controls = control.NEUTRAL,
    ) -> None:
        """Check the arguments of `generate` before there is speech.

        Raises:
            UserError: an argument cannot be used with speech of any length.
        """
        choose_style(self.spec, self.variables, self.assets, style, seed)
        if fps is not None:
            _check_fps(fps)
        control.check(controls, self.assets.skeleton)
        check_width(smoothing)
        if seed_pose is not None:
            read_seed_pose(seed_pose, self.assets.skeleton, self.fps, self.spec.num_seed_frames)


def load(source: str | pathlib.Path = "demo") -> Model:
    """Load a trained model.

    Args:
        source: "demo" for the model of the package, a folder that `ha2g export-model` wrote, or a workdir of
            `ha2g train`.

    Raises:
        UserError: there is no model, it is damaged, or it generates no motion, such as the pose auto-encoder.
    """
    loaded = model_folder.load(source)
    if loaded.spec.method not in METHODS:
        raise UserError(f"the model in {source} is of {loaded.spec.method}, which generates no motion; load another")
    return Model(loaded.spec, jax.device_put(loaded.variables), loaded.assets, loaded.config)


def generate_directions(
    model: Model,
    audio: np.ndarray,
    f_id: np.ndarray,
    seed: int = 0,
    *,
    words: Sequence[Word] = (),
    start: np.ndarray | None = None,
) -> np.ndarray:
    """Generate direction vectors at the frame rate of the model, from samples that have been checked.

    Args:
        model: trained model.
        audio: (samples,) float32 mono samples at 16 kHz.
        f_id: (style_dim,) style.
        seed: seed of the noise and of the choice of a seed pose.
        words: words of the audio, for a model that reads words.
        start: (M, bones, 3) unit vectors, the seed pose; by default `seed` selects one stored with the model.

    Returns:
        (T, bones, 3) float32 unit vectors, T = max(1, round(duration x fps)).

    Raises:
        UserError: the values of the model are not finite.
    """
    return _join(model, audio, f_id, seed, words, start)[: _num_frames(model, audio)]


def _join(
    model: Model, audio: np.ndarray, f_id: np.ndarray, seed: int, words: Sequence[Word], start: np.ndarray | None
) -> np.ndarray:
    """Return the joined frames of the windows that cover the audio; they may be longer than the audio."""
    bank = model.assets.seed_poses
    pose = bank[np.random.default_rng(seed).integers(len(bank))] if start is None else start
    features = _encode_windows(model, audio, words)
    windows = sample_windows(model.spec, model.variables, features, f_id, pose, seed)
    if not np.isfinite(windows).all():
        raise UserError(f"model {model.assets.hash} generated values that are not finite; train or export it again")
    return join_windows(windows, model.spec.num_seed_frames)


def encode_features(model: Model, audio: np.ndarray) -> Features:
    """Return the audio features f_low, f_mid and f_high of a clip, each (T, 32) at the frame rate of the model.

    Where two windows overlap, each frame is taken from the window whose border is farther away.

    Args:
        model: trained model with three audio levels.
        audio: (samples,) float32 mono samples at 16 kHz.
    """
    overlap = model.spec.num_seed_frames
    keep = slice(overlap // 2, overlap // 2 + model.spec.num_frames - overlap)

    def join(windows: np.ndarray) -> np.ndarray:
        middle = windows[:, keep].reshape(-1, windows.shape[-1])
        return np.concatenate([windows[0, : keep.start], middle, windows[-1, keep.stop :]])[: _num_frames(model, audio)]

    return jax.tree.map(join, _encode_windows(model, audio, ()))


def _num_frames(model: Model, audio: np.ndarray) -> int:
    return num_frames(len(audio) / SAMPLE_RATE, model.fps)


def _encode_windows(model: Model, audio: np.ndarray, words: Sequence[Word]) -> Any:
    count = num_windows(_num_frames(model, audio), model.spec.num_frames, model.spec.num_seed_frames)
    speech = prepare(audio, words, model.spec.inputs)
    return encode_windows(model.spec, model.variables, speech, model.assets.vocabulary, count)


def _check_fps(fps: float) -> float:
    if not (math.isfinite(fps) and MIN_FPS <= fps <= MAX_FPS):
        raise UserError(f"{fps} frames per second; expected {MIN_FPS} to {MAX_FPS}")
    return fps
