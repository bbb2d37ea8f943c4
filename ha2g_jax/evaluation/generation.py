"""Motion of a model for the clips of a corpus: the one place where the study calls a model to generate."""

from typing import NamedTuple

import numpy as np

from ha2g_jax import synthesis
from ha2g_jax.data.records import Clip
from ha2g_jax.synthesis import Model


class Windows(NamedTuple):
    """Windows that a model joins a long motion from.

    Attributes:
        seed_frames: number of frames that are given to the model.
        stride: number of frames between the first frames of two windows.
    """

    seed_frames: int
    stride: int


def model_windows(model: Model) -> Windows:
    """Return the windows of a model."""
    return Windows(model.spec.num_seed_frames, model.spec.num_frames - model.spec.num_seed_frames)


def generate_clip(
    model: Model,
    clip: Clip,
    style: np.ndarray,
    seed: int,
    *,
    start: np.ndarray | None = None,
    has_words: bool = True,
    look_ahead: int | None = None,
) -> np.ndarray:
    """Generate the direction vectors (T, bones, 3) of a motion for the speech of a clip.

    Args:
        model: model that makes the motion.
        clip: clip with sound and words.
        style: (style_dim,) style of the motion.
        seed: seed of everything that the model draws.
        start: (seed frames, bones, 3) poses to begin with; drawn by the model by default, and in a stream always.
        has_words: whether a model that reads words gets them.
        look_ahead: frames of speech that a stream hears beyond each frame, see `Model.stream`; None for the whole clip.

    Raises:
        UserError: the model cannot follow a stream, or not with this look-ahead.
    """
    if look_ahead is not None:
        stream = model.stream(look_ahead=look_ahead, style=synthesis.Style(values=style), seed=seed)
        return np.concatenate([stream.feed(clip.audio), stream.flush()])
    words = clip.words if has_words else ()
    return synthesis.generate_directions(model, clip.audio, style, seed, words=words, start=start)


def encode_high(model: Model, clip: Clip) -> np.ndarray:
    """Return f_high (T, 32) of the speech of a clip, of a model with a hierarchical audio encoder."""
    return np.asarray(synthesis.encode_features(model, clip.audio).high)
