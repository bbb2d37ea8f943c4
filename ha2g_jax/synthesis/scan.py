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

from ha2g_jax.data.speech import Speech, window
from ha2g_jax.features.text import Vocabulary
from ha2g_jax.methods.task import Task, restore, subtract_mean

# Windows that the audio encoder hears in one call: one compiled program and bounded memory for any length of speech.
_CHUNK = 16


def encode_windows(
    task: Task, variables: dict[str, Any], speech: Speech, vocabulary: Vocabulary, count: int, fps: int
) -> Any:
    """What the generator hears in the first `count` windows of a clip; past its end there is silence.

    Returns:
        What `listen` gives, such as `Features` of HA2G, with a leading axis (K, ...).
    """
    stride, inputs = task.num_frames - task.num_seed_frames, task.generator.inputs
    chunks = []
    for start in tqdm(range(0, count, _CHUNK), desc="listening", disable=None, delay=2):
        windows = [
            window(speech, inputs, vocabulary, index * stride, task.num_frames, fps)
            for index in range(start, start + _CHUNK)
        ]
        batch = {name: np.stack([heard[name] for heard in windows]) for name in inputs}
        chunks.append(jax.device_get(_listen(task, variables, batch)))
    return jax.tree.map(lambda *parts: np.concatenate(parts)[:count], *chunks)


def infer_windows(
    task: Task, variables: dict[str, Any], heard: Any, style: np.ndarray, start: np.ndarray
) -> np.ndarray:
    """Unit direction vectors (K, N, bones, 3) of K windows.

    Args:
        task, variables: the generator.
        heard: in each window, from `encode_windows`.
        style: (style_dim,) of all of them.
        start: (M, bones, 3) unit vectors, the seed pose of the first window.
    """
    count = len(jax.tree.leaves(heard)[0])
    missing = bucket(count) - count
    padded = jax.tree.map(lambda x: np.pad(x, ((0, missing), *((0, 0),) * (x.ndim - 1))), heard)
    identity, pose = jnp.asarray(style, jnp.float32), jnp.asarray(start, jnp.float32)
    return np.asarray(_infer(task, variables, padded, identity, pose))[:count]


def bucket(count: int) -> int:
    """The least of 1, 2, 3, 4, 6, 8, 12, 16, 24, ... that is not below `count`, so that few lengths are compiled."""
    power = 1 << (count - 1).bit_length()
    return 3 * power // 4 if power >= 4 and count <= 3 * power // 4 else power


@functools.partial(jax.jit, static_argnames="task")
def _listen(task: Task, variables: dict[str, Any], batch: dict[str, jax.Array]) -> Any:
    return task.generator.apply(variables, batch, train=False, method="listen")


@functools.partial(jax.jit, static_argnames="task")
def _infer(task: Task, variables: dict[str, Any], heard: Any, style: jax.Array, start: jax.Array) -> jax.Array:
    """What is heard in K windows and a start pose (M, bones, 3) to unit vectors (K, N, bones, 3)."""

    def window(seed: jax.Array, heard: Any) -> tuple[jax.Array, jax.Array]:
        heard = jax.tree.map(lambda x: x[None], heard)
        centred = subtract_mean(task, seed)[None]
        levels: Any = task.generator.apply(variables, heard, style[None], centred, train=False, method="infer")
        directions = restore(task, levels[-1][0])
        return directions[-task.num_seed_frames :], directions

    return jax.lax.scan(window, start, heard)[1]
