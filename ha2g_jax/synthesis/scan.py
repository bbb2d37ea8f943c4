"""The compiled part of generation: the speech of each window is encoded, and a scan over the windows samples poses.

Time is cut into windows of N frames, each of which starts `Spec.window_stride` frames after the one before; the M
frames of that window from there on are its seed pose. Both parts process chunks of a fixed number of windows, so that
two programs serve speech of any length. A separate thread encodes the next chunks while one is sampled, because neither
part keeps all cores busy: XLA computes convolutions with few channels, and products with a single row, on one core.
"""

import concurrent.futures
import contextlib
import functools
import itertools
from collections.abc import Generator
from typing import Any

import jax
import numpy as np

from ha2g_jax.data.speech import Speech, window
from ha2g_jax.features.noise import track
from ha2g_jax.features.text import Vocabulary
from ha2g_jax.methods import generating_method_of
from ha2g_jax.methods.method import Batch, Spec, Variables, restore, subtract_mean
from ha2g_jax.progress import progress_bar

# Windows in a chunk. The last chunk is padded with silence, so that larger numbers cost time for short speech; for long
# speech they gain nothing on CPUs.
_CHUNK = 4


def encode_windows(spec: Spec, variables: Variables, speech: Speech, vocabulary: Vocabulary, count: int) -> Any:
    """Encode the speech of the first `count` windows of a clip, with silence past its end.

    Returns:
        Features of `GeneratingMethod.encode_speech`, such as `Features` of HA2G, with a leading axis (count, ...).
    """
    chunks = encode_chunks(spec, variables, speech, vocabulary, count)
    return jax.tree.map(lambda *parts: np.concatenate(parts)[:count], *chunks)


def encode_chunks(
    spec: Spec, variables: Variables, speech: Speech, vocabulary: Vocabulary, count: int
) -> Generator[Any, None, None]:
    """Encode the speech of windows as `encode_windows` does, one chunk at a time.

    Yields:
        Features of each chunk in order, with a leading axis of its windows, the last of which may be beyond `count`.
    """

    def encode(start: int) -> Any:
        windows = [
            window(speech, spec.inputs, vocabulary, index * spec.window_stride, spec.num_frames, spec.fps)
            for index in range(start, start + _CHUNK)
        ]
        batch = {name: np.stack([inputs[name] for inputs in windows]) for name in spec.inputs}
        return jax.device_get(_encode_speech(spec, variables, batch))

    ahead = concurrent.futures.ThreadPoolExecutor(1)
    try:
        with progress_bar("generating", count, "window", is_part=True) as bar:
            for features in ahead.map(encode, range(0, count, _CHUNK)):
                yield features
                bar.update(min(_CHUNK, count - bar.n))
    finally:
        ahead.shutdown(cancel_futures=True)


def sample_windows(
    spec: Spec,
    variables: Variables,
    chunks: Generator[Any, None, None],
    style: np.ndarray,
    seed_pose: np.ndarray,
    seed: int,
    count: int,
) -> np.ndarray:
    """Sample the poses (K, N, bones, 3) of K = `count` windows, unit vectors, each starting from poses of the previous.

    `chunks` are those of `encode_chunks`; the generator is closed at the end. All windows have the style (style_dim,),
    and `seed_pose` (M, bones, 3) is that of the first. A frame has the same noise in a clip of any length.
    """
    style, pose = np.asarray(style, np.float32), np.asarray(seed_pose, np.float32)
    parts = []
    with contextlib.closing(chunks):  # Ctrl-C does not wait for the remaining chunks
        for first, features in zip(itertools.count(step=_CHUNK), chunks):
            noise = noise_of(spec, seed, (first + np.arange(_CHUNK)) * spec.window_stride)
            pose, poses = _sample(spec, variables, features, style, pose, noise)
            parts.append(poses)
    return np.concatenate(jax.device_get(parts))[:count]


def noise_of(spec: Spec, seed: int, first: np.ndarray) -> np.ndarray:
    """Return the noise (..., N, noise_dim) of the windows whose first frames have the numbers (...) in a clip."""
    return track(seed, first[..., None] + np.arange(spec.num_frames), spec.fps, spec.noise_dim)


@functools.partial(jax.jit, static_argnums=0)
def _encode_speech(spec: Spec, variables: Variables, batch: Batch) -> Any:
    return generating_method_of(spec).encode_speech(spec, variables, batch)


@functools.partial(jax.jit, static_argnums=0)
def _sample(
    spec: Spec,
    variables: Variables,
    features: Any,
    style: jax.Array,
    seed_pose: jax.Array,
    noise: jax.Array,
) -> tuple[jax.Array, jax.Array]:
    """Sample K consecutive windows of a clip, whose features and noise have a leading axis (K, ...).

    `seed_pose` (M, bones, 3) is that of the first window. Return the seed pose of the window after the last, and the
    poses of the windows (K, N, bones, 3).
    """

    def window(seed_pose: jax.Array, inputs: Any) -> tuple[jax.Array, jax.Array]:
        features, noise = inputs
        features = jax.tree.map(lambda x: x[None], features)
        directions = _poses(spec, variables, features, style, seed_pose, noise)
        return directions[spec.window_stride :][: spec.num_seed_frames], directions

    return jax.lax.scan(window, seed_pose, (features, noise))


@functools.partial(jax.jit, static_argnums=0)
def generate_window(
    spec: Spec,
    variables: Variables,
    speech: Batch,
    style: jax.Array,
    seed_pose: jax.Array,
    noise: jax.Array,
) -> jax.Array:
    """Encode the speech of one window of a stream, and sample its poses (N, bones, 3), unit vectors.

    The speech inputs have no batch axis; style (style_dim,) and seed pose (M, bones, 3) are those of `sample_windows`,
    the noise (N, noise_dim) is that of `noise_of`.
    """
    batch = {name: array[None] for name, array in speech.items()}
    features = generating_method_of(spec).encode_speech(spec, variables, batch)
    return _poses(spec, variables, features, style, seed_pose, noise)


def _poses(
    spec: Spec, variables: Variables, features: Any, style: jax.Array, seed_pose: jax.Array, noise: jax.Array
) -> jax.Array:
    """Return the poses of one window, (N, bones, 3) unit vectors; only the features have a batch axis."""
    centred = subtract_mean(spec, seed_pose)[None]
    poses = generating_method_of(spec).sample(spec, variables, features, style[None], centred, noise[None])
    return restore(spec, poses[0])
