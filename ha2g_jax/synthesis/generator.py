"""Motion from speech with a trained generator, with any runtime; this module needs neither JAX nor ONNX Runtime."""

import abc
import pathlib
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypedDict, TypeVar

import numpy as np

from ha2g_jax import __version__
from ha2g_jax.checkpoint.assets import Assets
from ha2g_jax.checkpoint.onnx.reading import Description
from ha2g_jax.errors import UserError, check_number
from ha2g_jax.features.audio import SAMPLE_RATE, check_samples, convert_samples, read_audio
from ha2g_jax.features.text import Word
from ha2g_jax.files.reading import shown
from ha2g_jax.limits import MAX_FPS, MIN_FPS
from ha2g_jax.motion import control
from ha2g_jax.motion import cues as gestures
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.resample import num_frames, resample, sample, slerp
from ha2g_jax.motion.smoothing import check_width, smooth
from ha2g_jax.motion.windows import ease_start, join_windows
from ha2g_jax.skeleton import Skeleton, mirror_directions
from ha2g_jax.synthesis.style import RANDOM, Style, check_seed

if TYPE_CHECKING:
    from ha2g_jax.methods.method import Spec

SeedPose = str | pathlib.Path | Motion | np.ndarray

_MIN_LENGTH = 1e-6  # length below which a vector has no direction

S = TypeVar("S", bound="Spec | Description")


class Audio(NamedTuple):
    """Speech that has been read and checked.

    Attributes:
        samples: (samples,) float32 mono samples at 16 kHz.
        name: name of the file, None for an array.
    """

    samples: np.ndarray
    name: str | None = None

    @property
    def duration(self) -> float:
        """Duration in seconds."""
        return len(self.samples) / SAMPLE_RATE

    def __repr__(self) -> str:
        return f"Audio({self.name or 'samples'}, {self.duration:.2f} s)"


Speech = str | pathlib.Path | np.ndarray | tuple[np.ndarray, int] | Audio


def read_speech(speech: Speech) -> Audio:
    """Read and check speech: a file with sound, sound with its rate, or (samples,) float mono samples at 16 kHz.

    Sound with its rate is (samples, rate), as soundfile.read, librosa.load and torchaudio.load return it; it is mixed
    and resampled like that of a file. A result of this function is returned as it is.

    Raises:
        UserError: the speech cannot be used, see `features.audio.read_audio`.
    """
    if isinstance(speech, Audio):
        return speech
    if isinstance(speech, str | pathlib.Path):
        return Audio(read_audio(speech), shown(pathlib.Path(speech).name))
    if isinstance(speech, tuple) and len(speech) == 2:
        return Audio(convert_samples(*speech))
    samples = np.asarray(speech)
    if samples.ndim != 1 or not np.issubdtype(samples.dtype, np.floating):
        raise UserError(f"speech is an array of {samples.dtype}, shape {samples.shape}; expected float mono at 16 kHz")
    return Audio(check_samples(samples.astype(np.float32)))


def read_seed_pose(source: SeedPose, skeleton: Skeleton, fps: float, count: int) -> tuple[np.ndarray, str]:
    """Return a seed pose for a model, (M, bones, 3) float32 unit vectors, and its name for the metadata of the motion.

    Args:
        source: motion, or the path of its `.npz`, whose last frames are used; a pose (bones, 3); or poses
            (F, bones, 3) at `fps`, the last of which are used.
        skeleton, fps: skeleton and frame rate of the model.
        count: number of frames of a seed pose, M; if the source is shorter, its first pose is repeated.

    Raises:
        UserError: there is no such file, it has another skeleton, or a vector has length zero or is not finite.
    """
    name, rate = "motion" if isinstance(source, Motion) else "array", fps
    if isinstance(source, str | pathlib.Path):
        name, source = shown(pathlib.Path(source).name), Motion.load(source)
    if isinstance(source, Motion):
        if source.meta["skeleton"] != skeleton.name:
            raise UserError(
                f"the seed pose {name} is of the skeleton {source.meta['skeleton']}, the model of {skeleton.name}; "
                "give a motion on the skeleton of the model"
            )
        source, rate = source.directions, source.fps
    poses = np.asarray(source)
    poses = poses[None] if poses.ndim == 2 else poses
    if poses.ndim != 3 or not len(poses) or poses.shape[1:] != (skeleton.num_bones, 3):
        raise UserError(
            f"the seed pose {name} has the shape {poses.shape}; expected ({skeleton.num_bones}, 3) direction vectors "
            f"of {skeleton.name}, or (frames, {skeleton.num_bones}, 3)"
        )
    lengths = np.linalg.norm(poses.astype(np.float64), axis=-1, keepdims=True)
    if not (np.isfinite(lengths).all() and lengths.min() > _MIN_LENGTH):
        raise UserError(f"the seed pose {name} has vectors that are not finite or of no length; give another pose")
    places = len(poses) - 1 - np.arange(count)[::-1] * (rate / fps)
    return sample(poses / lengths, places), name


def start_from(directions: np.ndarray, seed: np.ndarray) -> np.ndarray:
    """Blend a seed pose (M, bones, 3) into the first frames of a motion (T, bones, 3), so that frame 0 is its first.

    Both are unit vectors; the result is float32.
    """
    count = min(len(seed), len(directions))
    weight = (np.arange(count, dtype=np.float32) / len(seed))[:, None, None]
    return np.concatenate([slerp(seed[:count], directions[:count], weight), directions[count:]]).astype(np.float32)


class Options(TypedDict, total=False):
    """Keyword arguments of `Generator.generate`, except `words`."""

    style: Style
    seed: int
    seed_pose: SeedPose | None
    fps: float | None
    smoothing: float
    controls: control.Controls
    cues: Sequence[gestures.Cue | str]


class Generator(abc.ABC, Generic[S]):
    """A trained generator of motion: `Model` computes with JAX, `OnnxModel` with ONNX Runtime.

    Attributes:
        spec: sizes of the model.
        assets: skeleton, styles of the training speakers, and calm seed poses.
    """

    spec: S
    assets: Assets

    def __repr__(self) -> str:
        size = f"{self.fps} fps, {len(self.speakers)} speakers, hash {self.assets.hash}"
        return f"{type(self).__name__}({self.name!r}, {self.spec.method}, {self.assets.skeleton.name}, {size})"

    @property
    def speakers(self) -> tuple[str, ...]:
        """Names of the speakers of training, which a `Style` takes."""
        return tuple(self.assets.speakers)

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
        """Frames per second of the generated poses."""
        return self.spec.fps

    @abc.abstractmethod
    def choose_style(self, style: Style, seed: int) -> tuple[np.ndarray, dict[str, Any]]:
        """Return the values f_id of a requested style and their description, see `style.choose_style`."""

    @abc.abstractmethod
    def sample_windows(
        self, audio: np.ndarray, words: Sequence[Word], style: np.ndarray, seed_pose: np.ndarray, seed: int
    ) -> np.ndarray:
        """Sample the poses of all windows of speech that has been checked.

        Args:
            audio: (samples,) float32 mono samples at 16 kHz.
            words: words of the audio, for a model that reads words.
            style: (style_dim,) style.
            seed_pose: (M, bones, 3) unit vectors, the seed pose of the first window.
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
        cues: Sequence[gestures.Cue | str] = (),
        words: Sequence[Word] = (),
    ) -> Motion:
        """Generate gestures for speech; the same arguments give the same motion.

        Args:
            speech: path of a file with sound, (samples, rate) as soundfile.read or librosa.load return it, (samples,)
                float mono samples at 16 kHz, or the result of `read_speech`.
            style: requested style; by default a random one with `seed`, see `style.choose_style`.
            seed: seed of all random choices.
            seed_pose: motion, or the path of its `.npz`, that this motion continues: frame 0 is the first of the last M
                frames of that motion; or a pose (bones, 3) to start from. By default `seed` selects one of the calm
                poses stored with the model.
            fps: frames per second of the result, by default those of the model; other rates are interpolated.
            smoothing: length in seconds of the window over which poses are averaged, see `motion.smoothing`; 0 for no
                smoothing.
            controls: controls of the motion, see `motion.control`.
            cues: gestures that are made after the controls, at a time or on a word, see `motion.cues`.
            words: words of the speech, in order of time, for a model that `reads_words` and for cues on words; the HA2G
                of the paper needs none.

        Returns:
            Motion of exactly round(duration x fps) frames, at least 1.

        Raises:
            UserError: the speech, the style, a seed, the seed pose, the frame rate, the smoothing, a control, a cue
                or a word cannot be used.
        """
        seed = check_seed(seed)
        f_id, described = self.choose_style(style, seed)
        fps = self.fps if fps is None else _check_fps(fps)
        audio = read_speech(speech)
        skeleton, overlap = self.assets.skeleton, self.spec.num_seed_frames
        control.check(controls, skeleton, audio.duration)
        if not (isinstance(words, Sequence) and all(isinstance(word, Word) for word in words)):
            raise UserError("the words are not a sequence of Word; give words such as Word('hello', 0.2, 0.6)")
        placed = gestures.place(cues, words, audio.duration)
        made = [(gestures.keyframes_of(cue, skeleton, fps), cue.time) for cue in placed]
        smoothing = check_width(smoothing)
        given = start = start_name = None
        if seed_pose is not None:
            given, start_name = read_seed_pose(seed_pose, skeleton, self.fps, overlap)
            start = mirror_directions(skeleton, given) if controls.mirror else given
        directions = join(self, audio.samples, f_id, seed, words, start)
        if start is not None:
            directions = ease_start(start_from(directions, start), self.spec.num_frames, overlap)
        frames = num_frames(audio.duration, fps)
        plain = directions[:frames] if fps == self.fps else resample(directions, self.fps, fps, frames)
        directions = control.change(skeleton, smooth(plain, fps, smoothing), fps, controls)
        if given is not None and directions is not plain:  # the given pose has been changed already
            places = np.arange(max(1, round(overlap * fps / self.fps))) * (self.fps / fps)
            directions = start_from(directions, sample(given, places))
        directions = control.hold(skeleton, directions, fps, controls)
        before = None if start is None else directions[0]
        directions = gestures.apply(skeleton, directions, fps, made, before)
        optional = {
            "seed_pose": start_name,
            "smoothing": smoothing,
            "controls": control.describe(controls),
            "cues": gestures.describe(placed),
        }
        meta = {
            "version": __version__,
            "model": self.name,
            "checkpoint": self.assets.hash,
            "speech": audio.name,
            "duration": audio.duration,
            "style": described,
            "seed": seed,
        }
        return Motion.from_directions(
            skeleton, directions, fps, meta | {name: it for name, it in optional.items() if it}
        )

    def check_options(
        self,
        *,
        style: Style = RANDOM,
        seed: int = 0,
        seed_pose: SeedPose | None = None,
        fps: float | None = None,
        smoothing: float = 0.0,
        controls: control.Controls = control.NEUTRAL,
        cues: Sequence[gestures.Cue | str] = (),
    ) -> None:
        """Check the arguments of `generate`, except speech and words, before the speech is known.

        Raises:
            UserError: an argument cannot be used with speech of any length.
        """
        self.choose_style(style, seed)
        if fps is not None:
            _check_fps(fps)
        control.check(controls, self.assets.skeleton)
        for cue in cues:
            gestures.keyframes_of(gestures.check_cue(cue), self.assets.skeleton, self.fps)
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
    """Return the joined frames (T, bones, 3) of the windows that cover checked speech; they may be longer than it.

    The arguments are those of `Generator.sample_windows`; `start` is the seed pose, by default one of the model's that
    the seed selects.

    Raises:
        UserError: the values of the model are not finite.
    """
    assets = generator.assets
    pose = assets.seed_poses[assets.choose_seed_pose(seed)] if start is None else start
    windows = generator.sample_windows(audio, words, f_id, pose, seed)
    if not np.isfinite(windows).all():
        raise UserError(f"model {generator.assets.hash} generated values that are not finite; train or export it again")
    return join_windows(windows, generator.spec.num_seed_frames, generator.spec.window_stride)


def _check_fps(fps: float) -> float:
    return check_number(fps, MIN_FPS, MAX_FPS, f"{fps} frames per second; expected {MIN_FPS} to {MAX_FPS}")
