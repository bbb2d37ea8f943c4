"""The compiled part of generation: the speech of each window is encoded, and one scan over the windows samples poses.

Time is cut into windows of N frames, each of which starts M frames before the one before ends; the last M frames of a
window are the seed pose of the next.
"""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from tqdm import tqdm

from ha2g_jax.data.speech import Speech, window
from ha2g_jax.features.text import Vocabulary
from ha2g_jax.methods.build import generating_method_of
from ha2g_jax.methods.method import Batch, Spec, Variables, restore, subtract_mean

# Windows whose speech is encoded in one call: one compiled program and bounded memory for any length of speech.
_CHUNK = 16


def encode_windows(spec: Spec, variables: Variables, speech: Speech, vocabulary: Vocabulary, count: int) -> Any:
    """Encode the speech of the first `count` windows of a clip; past its end there is silence.

    Args:
        spec, variables: the generator.
        speech: speech of the clip, from `data.speech.prepare`.
        vocabulary: words of the model.
        count: number of windows.

    Returns:
        Features of `GeneratingMethod.encode_speech`, such as `Features` of HA2G, with a leading axis (count, ...).
    """
    stride = spec.num_frames - spec.num_seed_frames
    chunks = []
    with tqdm(desc="encoding speech", total=count, unit="window", disable=None, delay=2, leave=False) as bar:
        for start in range(0, count, _CHUNK):
            windows = [
                window(speech, spec.inputs, vocabulary, index * stride, spec.num_frames, spec.fps)
                for index in range(start, start + _CHUNK)
            ]
            batch = {name: np.stack([inputs[name] for inputs in windows]) for name in spec.inputs}
            chunks.append(jax.device_get(_encode_speech(spec, variables, batch)))
            bar.update(min(_CHUNK, count - start))
    return jax.tree.map(lambda *parts: np.concatenate(parts)[:count], *chunks)


def sample_windows(
    spec: Spec, variables: Variables, features: Any, style: np.ndarray, start: np.ndarray, seed: int
) -> np.ndarray:
    """Sample the poses of K windows, each from the last poses of the one before.

    Args:
        spec, variables: the generator.
        features: features of the windows, from `encode_windows`.
        style: (style_dim,) style of all of them.
        start: (M, bones, 3) unit vectors, the seed pose of the first window.
        seed: seed of the noise; window k has the same noise in a clip of any length.

    Returns:
        (K, N, bones, 3) unit vectors.
    """
    count = len(jax.tree.leaves(features)[0])
    missing = bucket(count) - count
    padded = jax.tree.map(lambda x: np.pad(x, ((0, missing), *((0, 0),) * (x.ndim - 1))), features)
    style, start = np.asarray(style, np.float32), np.asarray(start, np.float32)
    return np.asarray(_sample(spec, variables, padded, style, start, jax.random.key(seed)))[:count]


def bucket(count: int) -> int:
    """Return the smallest of 1, 2, 3, 4, 6, 8, 12, 16, 24, ... not below `count`, so that few lengths are compiled."""
    power = 1 << (count - 1).bit_length()
    return 3 * power // 4 if power >= 4 and count <= 3 * power // 4 else power


@functools.partial(jax.jit, static_argnums=0)
def _encode_speech(spec: Spec, variables: Variables, batch: Batch) -> Any:
    return generating_method_of(spec).encode_speech(spec, variables, batch)


@functools.partial(jax.jit, static_argnums=0)
def _sample(
    spec: Spec, variables: Variables, features: Any, style: jax.Array, start: jax.Array, key: jax.Array
) -> jax.Array:
    """Sample (K, N, bones, 3) unit vectors from the features of K windows and a start pose (M, bones, 3)."""
    method = generating_method_of(spec)

    def window(seed: jax.Array, inputs: Any) -> tuple[jax.Array, jax.Array]:
        index, features = inputs
        features = jax.tree.map(lambda x: x[None], features)
        centred = subtract_mean(spec, seed)[None]
        poses = method.sample(spec, variables, features, style[None], centred, jax.random.fold_in(key, index))
        directions = restore(spec, poses[0])
        return directions[-spec.num_seed_frames :], directions

    indices = jnp.arange(len(jax.tree.leaves(features)[0]))
    return jax.lax.scan(window, start, (indices, features))[1]
