"""The compiled part of generation: what is heard in each window, and one scan over the windows.

Time is cut into windows of N frames, each M frames into the one before; the last M frames of a window are the seed
pose of the next.
"""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from tqdm import tqdm

from ha2g_jax.audio import log_mel, mel_window
from ha2g_jax.models import Features
from ha2g_jax.train.task import Task, restore, subtract_mean

# Windows that the audio encoder hears in one call: one compiled program and bounded memory for any length of speech.
_CHUNK = 16


def encode_windows(task: Task, variables: dict[str, Any], audio: np.ndarray, count: int, fps: int) -> Features:
    """Audio features of the first `count` windows of a clip, each (K, N, 32); past its end there is silence."""
    mel = log_mel(audio)
    stride = task.num_frames - task.num_seed_frames
    chunks = []
    for start in tqdm(range(0, count, _CHUNK), desc="listening", disable=None, delay=2):
        windows = [mel_window(mel, index * stride, fps) for index in range(start, start + _CHUNK)]
        chunks.append(jax.device_get(_encode(task, variables, np.stack(windows))))
    return jax.tree.map(lambda *parts: np.concatenate(parts)[:count], *chunks)


def infer_windows(
    task: Task, variables: dict[str, Any], features: Features, f_id: np.ndarray, start: np.ndarray
) -> np.ndarray:
    """Unit direction vectors (K, N, bones, 3) of K windows.

    Args:
        task, variables: the generator.
        features: of each window, (K, N, 32).
        f_id: (18,) identity of all of them.
        start: (M, bones, 3) unit vectors, the seed pose of the first window.
    """
    count = len(features.low)
    missing = bucket(count) - count
    padded = jax.tree.map(lambda x: np.pad(x, ((0, missing), (0, 0), (0, 0))), features)
    identity, pose = jnp.asarray(f_id, jnp.float32), jnp.asarray(start, jnp.float32)
    return np.asarray(_infer(task, variables, padded, identity, pose))[:count]


def bucket(count: int) -> int:
    """The least of 1, 2, 3, 4, 6, 8, 12, 16, 24, ... that is not below `count`, so that few lengths are compiled."""
    power = 1 << (count - 1).bit_length()
    return 3 * power // 4 if power >= 4 and count <= 3 * power // 4 else power


@functools.partial(jax.jit, static_argnames="task")
def _encode(task: Task, variables: dict[str, Any], mel: jax.Array) -> Features:
    features: Any = task.generator.apply(variables, mel, train=False, method="encode_audio")
    return features


@functools.partial(jax.jit, static_argnames="task")
def _infer(task: Task, variables: dict[str, Any], features: Features, f_id: jax.Array, start: jax.Array) -> jax.Array:
    """Features of K windows, each (K, N, 32), and a start pose (M, bones, 3) to unit vectors (K, N, bones, 3)."""

    def window(seed: jax.Array, features: Features) -> tuple[jax.Array, jax.Array]:
        heard = jax.tree.map(lambda x: x[None], tuple(features))
        centred = subtract_mean(task, seed)[None]
        levels: Any = task.generator.apply(variables, heard, f_id[None], centred, train=False, method="infer")
        directions = restore(task, levels[-1][0])
        return directions[-task.num_seed_frames :], directions

    return jax.lax.scan(window, start, features)[1]
