"""A trained model that generates motion from speech."""

import dataclasses
import pathlib
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np

from ha2g_jax.checkpoint import model_folder
from ha2g_jax.checkpoint.assets import Assets
from ha2g_jax.config.settings import Config
from ha2g_jax.data.speech import Speech, prepare
from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.features.text import Word
from ha2g_jax.layers.resnet_se import Features
from ha2g_jax.methods import METHODS
from ha2g_jax.methods.method import Spec, Variables
from ha2g_jax.motion import control
from ha2g_jax.motion.resample import num_frames
from ha2g_jax.motion.windows import DEFAULT_HOP, DEFAULT_LOOK_AHEAD, num_windows
from ha2g_jax.synthesis.generator import Generator, join
from ha2g_jax.synthesis.scan import encode_chunks, encode_windows, sample_windows
from ha2g_jax.synthesis.stream import Stream
from ha2g_jax.synthesis.style import RANDOM, Style, choose_style


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Model(Generator[Spec]):
    """A trained generator that computes with JAX, see `load`.

    Attributes:
        spec: networks and sizes.
        variables: parameters and BatchNorm statistics of the generator.
        assets: skeleton, vocabulary, styles of the training speakers, and calm seed poses.
        config: settings that the networks are built from.
    """

    spec: Spec  # pyrefly: ignore[bad-override]
    variables: Variables
    assets: Assets  # pyrefly: ignore[bad-override]
    config: Config

    @property
    def reads_words(self) -> bool:
        return bool({"words", "plain_words"} & set(self.spec.inputs))

    @property
    def has_audio_levels(self) -> bool:
        """Whether the model has the three audio levels of HA2G, which `encode_features` returns."""
        return self.spec.method in ("ha2g", "energy_ha2g")

    @property
    def name(self) -> str:
        return self.config.name

    def choose_style(self, style: Style, seed: int) -> tuple[np.ndarray, dict[str, Any]]:
        return choose_style(self.spec, self.variables, self.assets, style, seed)

    def sample_windows(
        self, audio: np.ndarray, words: Sequence[Word], style: np.ndarray, seed_pose: np.ndarray, seed: int
    ) -> np.ndarray:
        speech, count = _windows(self, audio, words)
        chunks = encode_chunks(self.spec, self.variables, speech, self.assets.vocabulary, count)
        return sample_windows(self.spec, self.variables, chunks, style, seed_pose, seed, count)

    def stream(
        self,
        *,
        look_ahead: int = DEFAULT_LOOK_AHEAD,
        hop: int = DEFAULT_HOP,
        style: Style = RANDOM,
        seed: int = 0,
        controls: control.Controls = control.NEUTRAL,
        reference: float | None = None,
    ) -> Stream:
        """Begin a motion that follows speech while it arrives; the generator is compiled before this returns.

        Args:
            look_ahead: frames of speech that are heard beyond the last new frame, 0 to N. With more of them gestures
                fit the speech better, but come later.
            hop: frames that are generated in one run, 1 to N - 2 M. A larger hop needs less computation.
            style: requested style; by default a random one with `seed`, see `style.choose_style`.
            seed: seed of all random choices.
            controls: energy, extent, handedness and mirror.
            reference: mel power of 0 dB; by default a running level, see `RunningMel`.

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
            has_hidden_ends=self.config.data.get("lookahead", 0.0) > 0,
        )


def load(source: str | pathlib.Path = "demo") -> Model:
    """Load a trained model.

    The source is "demo" for the model of the package, a folder that `ha2g model export` wrote, a workdir of
    `ha2g train`, or hf://OWNER/NAME@REVISION for a model on the Hugging Face Hub.

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

    The arguments are those of `generator.join`.

    Returns:
        (T, bones, 3) float32 unit vectors, T = max(1, round(duration x fps)).

    Raises:
        UserError: the values of the model are not finite.
    """
    return join(model, audio, f_id, seed, words, start)[: _num_frames(model, audio)]


def encode_features(model: Model, audio: np.ndarray) -> Features:
    """Return the audio features f_low, f_mid and f_high of a clip, each (T, 32) at the frame rate of the model.

    The model has three audio levels, and the clip (samples,) float32 mono samples at 16 kHz. Where two windows overlap,
    each frame is taken from the window whose border is farther away.
    """
    stride = model.spec.window_stride
    start = (model.spec.num_frames - stride) // 2
    keep = slice(start, start + stride)

    def joined(windows: np.ndarray) -> np.ndarray:
        middle = windows[:, keep].reshape(-1, windows.shape[-1])
        return np.concatenate([windows[0, : keep.start], middle, windows[-1, keep.stop :]])[: _num_frames(model, audio)]

    speech, count = _windows(model, audio, ())
    low, mid, high, *_ = encode_windows(model.spec, model.variables, speech, model.assets.vocabulary, count)
    return jax.tree.map(joined, Features(low, mid, high))


def _num_frames(model: Model, audio: np.ndarray) -> int:
    return num_frames(len(audio) / SAMPLE_RATE, model.fps)


def _windows(model: Model, audio: np.ndarray, words: Sequence[Word]) -> tuple[Speech, int]:
    """Return the prepared speech of a clip and the number of windows that cover it."""
    count = num_windows(_num_frames(model, audio), model.spec.num_frames, model.spec.window_stride)
    return prepare(audio, words, model.spec.inputs), count
