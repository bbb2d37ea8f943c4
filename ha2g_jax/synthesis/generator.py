"""Motion from speech with a trained generator, whatever computes its windows; no accelerator library is needed here."""

import abc
import importlib.metadata
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Generic, TypedDict, TypeVar

import numpy as np

from ha2g_jax.checkpoint.assets import Assets
from ha2g_jax.checkpoint.onnx.reading import Description
from ha2g_jax.errors import UserError
from ha2g_jax.features.text import Word
from ha2g_jax.limits import MAX_FPS, MIN_FPS
from ha2g_jax.motion import control
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.resample import num_frames, resample
from ha2g_jax.motion.smoothing import check_width, smooth
from ha2g_jax.motion.windows import ease_borders, join_windows
from ha2g_jax.synthesis.seed_pose import SeedPose, read_seed_pose, start_from
from ha2g_jax.synthesis.speech import Speech, read_speech
from ha2g_jax.synthesis.style import RANDOM, Style

if TYPE_CHECKING:
    from ha2g_jax.methods.method import Spec

S = TypeVar("S", bound="Spec | Description")


class Options(TypedDict, total=False):
    """Keyword arguments of `Generator.generate`, except `words`."""

    style: Style
    seed: int
    seed_pose: SeedPose | None
    fps: float | None
    smoothing: float
    controls: control.Controls


class Generator(abc.ABC, Generic[S]):
    """A trained generator of motion: `Model` computes with JAX, `OnnxModel` with ONNX Runtime.

    Attributes:
        spec: sizes of the model.
        assets: skeleton, styles of the training speakers, and calm seed poses.
    """

    spec: S
    assets: Assets

    @property
    @abc.abstractmethod
    def name(self) -> str:
        """Name of the config, for the metadata of motion."""

    @property
    @abc.abstractmethod
    def reads_words(self) -> bool:
        """Whether the words of the speech change the motion."""

    @property
    def fps(self) -> int:
        """Frames per second of the poses that the generator samples."""
        return self.spec.fps

    @abc.abstractmethod
    def choose_style(self, style: Style, seed: int) -> tuple[np.ndarray, dict[str, Any]]:
        """Return the values f_id of a requested style and their description, see `style.choose_style`."""

    @abc.abstractmethod
    def sample_windows(
        self, audio: np.ndarray, words: Sequence[Word], style: np.ndarray, start: np.ndarray, seed: int
    ) -> np.ndarray:
        """Sample the poses of all windows of speech that has been checked.

        Args:
            audio: (samples,) float32 mono samples at 16 kHz.
            words: words of the audio, for a model that reads words.
            style: (style_dim,) style.
            start: (M, bones, 3) unit vectors, the seed pose of the first window.
            seed: seed of the noise.

        Returns:
            (K, N, bones, 3) unit vectors.
        """

    def generate(
        self,
        speech: Speech,
        *,
        style: Style = RANDOM,
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
            style: requested style; by default a random one with `seed`, see `style.choose_style`.
            seed: seed of all random choices.
            seed_pose: motion, or the path of its `.npz`, that this motion continues: frame 0 is the first of the last M
                frames of that motion; or a pose (bones, 3) to start from. By default `seed` selects one of the calm
                poses stored with the model.
            fps: frames per second of the result, by default those of the model; other rates are interpolated.
            smoothing: length in seconds of the window over which poses are averaged, see `motion.smoothing`; 0 for no
                smoothing.
            controls: controls of the motion, see `motion.control`.
            words: words of the speech, in order of time, for a model that `reads_words`; HA2G of the paper needs none.

        Returns:
            Motion of exactly round(duration x fps) frames, at least 1.

        Raises:
            UserError: the speech, the style, a seed, the seed pose, the frame rate or a control cannot be used.
        """
        f_id, described = self.choose_style(style, seed)
        fps = self.fps if fps is None else _check_fps(fps)
        audio = read_speech(speech)
        skeleton, overlap = self.assets.skeleton, self.spec.num_seed_frames
        control.check(controls, skeleton, audio.duration)
        check_width(smoothing)
        start = start_name = None
        if seed_pose is not None:
            start, start_name = read_seed_pose(seed_pose, skeleton, self.fps, overlap)
        directions = join(self, audio.samples, f_id, seed, words, start)
        directions = directions if start is None else start_from(directions, start)
        directions = ease_borders(directions, self.spec.num_frames, overlap, from_start=start is not None)
        frames = num_frames(audio.duration, fps)
        directions = directions[:frames] if fps == self.fps else resample(directions, self.fps, fps, frames)
        directions = control.apply(skeleton, smooth(directions, fps, smoothing), fps, controls)
        asked = {"seed_pose": start_name, "smoothing": smoothing, "controls": control.describe(controls)}
        meta = {
            "version": importlib.metadata.version("ha2g-jax"),
            "model": self.name,
            "checkpoint": self.assets.hash,
            "speech": audio.name,
            "duration": audio.duration,
            "style": described,
            "seed": seed,
        }
        return Motion.from_directions(skeleton, directions, fps, meta | {name: it for name, it in asked.items() if it})

    def check_options(
        self,
        *,
        style: Style = RANDOM,
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
        self.choose_style(style, seed)
        if fps is not None:
            _check_fps(fps)
        control.check(controls, self.assets.skeleton)
        check_width(smoothing)
        if seed_pose is not None:
            read_seed_pose(seed_pose, self.assets.skeleton, self.fps, self.spec.num_seed_frames)


def join(
    generator: Generator[Any],
    audio: np.ndarray,
    f_id: np.ndarray,
    seed: int,
    words: Sequence[Word] = (),
    start: np.ndarray | None = None,
) -> np.ndarray:
    """Return the joined frames of the windows that cover speech that has been checked; they may be longer than it.

    Args:
        generator: trained generator.
        audio: (samples,) float32 mono samples at 16 kHz.
        f_id: (style_dim,) style.
        seed: seed of the noise and of the choice of a seed pose.
        words: words of the audio, for a model that reads words.
        start: (M, bones, 3) unit vectors, the seed pose; by default `seed` selects one stored with the model.

    Returns:
        (T, bones, 3) float32 unit vectors.

    Raises:
        UserError: the values of the model are not finite.
    """
    bank = generator.assets.seed_poses
    pose = bank[np.random.default_rng(seed).integers(len(bank))] if start is None else start
    windows = generator.sample_windows(audio, words, f_id, pose, seed)
    if not np.isfinite(windows).all():
        raise UserError(f"model {generator.assets.hash} generated values that are not finite; train or export it again")
    return join_windows(windows, generator.spec.num_seed_frames)


def _check_fps(fps: float) -> float:
    if not (math.isfinite(fps) and MIN_FPS <= fps <= MAX_FPS):
        raise UserError(f"{fps} frames per second; expected {MIN_FPS} to {MAX_FPS}")
    return fps
