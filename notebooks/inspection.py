"""What the parts of a trained HA2G compute: blend of the audio levels, words beside the audio, poses of each stage.

All functions take a model of HA2G or energy_ha2g with the networks of the paper.
"""

import functools
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ha2g_jax.data.speech import prepare
from ha2g_jax.errors import UserError
from ha2g_jax.features.text import Word, words_to_frames
from ha2g_jax.methods.ha2g.model import HA2G
from ha2g_jax.methods.method import Spec, Variables, restore, subtract_mean
from ha2g_jax.synthesis import Model, encode_features
from ha2g_jax.synthesis.scan import encode_windows, noise_of

_MIN_NORM = 1e-8


def audio_blend(model: Model, styles: np.ndarray) -> np.ndarray:
    """Return the style coordinator C of Eq. 3: how much each audio level counts in each level of the motion.

    Of styles f_id (S, style_dim) it is (S, 3, H), weights of low, mid and high; each column sums to 1.

    Raises:
        UserError: a model of another method.
    """
    _check(model)
    return np.asarray(_coordinate(model.spec, model.variables, np.asarray(styles, np.float32)))


def text_features(model: Model, words: Sequence[Word], num_frames: int) -> np.ndarray:
    """Return the text features f_t (T, 32) of the words of a clip, which serve the contrastive loss alone.

    Raises:
        UserError: a model of another method.
    """
    _check(model)
    frames = words_to_frames(words, model.assets.vocabulary, 0.0, num_frames, model.fps)
    return np.asarray(_encode_text(model.spec, model.variables, frames))


def word_similarities(model: Model, audio: np.ndarray, words: Sequence[Word]) -> dict[str, np.ndarray]:
    """Return sim(f_t, f_l) of Eq. 2 between every word of a clip and the sound of every word, for each audio level l.

    The features of a word and of its sound are those of the frame in which the word starts. The contrastive loss makes
    the diagonal of the high level large beside everything else.

    Returns:
        A matrix (n, n) of cosines for "low", "mid" and "high": rows are words, columns are sounds.

    Raises:
        UserError: a model of another method, or a word that starts after the end of the sound.
    """
    _check(model)
    levels = encode_features(model, np.asarray(audio, np.float32))
    num_frames = len(levels.high)
    onsets = [int(word.start * model.fps) for word in words]
    if max(onsets, default=0) >= num_frames:
        raise UserError(f"a word starts in frame {max(onsets)} of {num_frames}; give the words of this sound")
    text = _unit(text_features(model, words, num_frames)[onsets])
    return {name: text @ _unit(np.asarray(level)[onsets]).T for name, level in levels._asdict().items()}


def stage_poses(
    model: Model, audio: np.ndarray, style: np.ndarray, seed_pose: np.ndarray, *, window: int = 0, seed: int = 0
) -> np.ndarray:
    """Return the poses of every stage of the pose inferer for one window of a clip (Eq. 4).

    Args:
        seed_pose: (M, bones, 3) unit vectors, the poses before the window.
        window: number of the window, which begins at frame `window` x `Spec.window_stride`.
        seed: seed of the noise of a model that samples.

    Returns:
        (H, N, bones, 3) unit vectors; bones that a level does not have yet are those of the mean pose.

    Raises:
        UserError: a model of another method.
    """
    generator, spec = _check(model), model.spec
    speech = prepare(np.asarray(audio, np.float32), (), spec.inputs)
    features = encode_windows(spec, model.variables, speech, model.assets.vocabulary, window + 1)
    own = jax.tree.map(lambda windows: windows[window:][:1], features)
    noise = noise_of(spec, seed, np.asarray(window * spec.window_stride))
    style, seed_pose = np.asarray(style, np.float32), np.asarray(seed_pose, np.float32)
    poses = _infer(spec, model.variables, own, style, seed_pose, noise)
    stages = np.zeros((len(poses), spec.num_frames, spec.skeleton.pose_dim), np.float32)
    for stage, channels, found in zip(stages, generator.level_channels, poses, strict=True):
        stage[:, list(channels)] = found
    return np.asarray(restore(spec, jnp.asarray(stages)))


def _check(model: Model) -> HA2G:
    """Return the generator of a model, which has the parts that the paper describes."""
    if not isinstance(model.spec.generator, HA2G):
        raise UserError(f"the model is of {model.spec.method}, not HA2G with the networks of the paper; load another")
    return model.spec.generator


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), _MIN_NORM)


@functools.partial(jax.jit, static_argnums=0)
def _coordinate(spec: Spec, variables: Variables, styles: jax.Array) -> jax.Array:
    return spec.generator.apply(variables, styles, method="coordinate")


@functools.partial(jax.jit, static_argnums=0)
def _encode_text(spec: Spec, variables: Variables, frames: jax.Array) -> jax.Array:
    return spec.generator.apply(variables, frames[None], train=False, method="encode_text")[0]


@functools.partial(jax.jit, static_argnums=0)
def _infer(
    spec: Spec, variables: Variables, features: Any, style: jax.Array, seed_pose: jax.Array, noise: jax.Array
) -> list[jax.Array]:
    """Return the flat poses (N, d^h) of each stage."""
    seed = subtract_mean(spec, seed_pose)[None]
    levels = spec.generator.apply(variables, features, style[None], seed, noise[None], train=False, method="infer")
    return [poses[0] for poses in levels]
