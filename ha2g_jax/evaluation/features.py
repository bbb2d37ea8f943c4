"""Features of motion for the Frechet distance and diversity: the latents of a trained pose auto-encoder."""

import functools
import hashlib
import os
import pathlib
from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import safetensors.numpy
from flax import traverse_util

from ha2g_jax.checkpoint import model_folder
from ha2g_jax.data.records import WINDOW_FRAMES
from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import shown
from ha2g_jax.methods.autoencoder import PoseAutoencoder
from ha2g_jax.methods.method import Spec, subtract_mean
from ha2g_jax.skeleton import Skeleton

_TRAIN_ONE = "train one with `ha2g train --config autoencoder:DATA`"
_EXPECTED = f"a workdir or an exported folder of a pose auto-encoder, as none comes with the package; {_TRAIN_ONE}"
_BATCH = 256  # windows that are encoded at once; the last batch is padded, so that only one shape is compiled


class PoseFeatures:
    """Pose auto-encoder (HA2G, Table 9) of a workdir or a model folder, in evaluation mode.

    Attributes:
        id: SHA-256 of the weights. Distances in the latent spaces of two auto-encoders cannot be compared.
        name: name of the config.
        data: name of the corpus that the auto-encoder was trained on.
        skeleton: skeleton with the mean direction vectors that are subtracted.

    Raises:
        UserError: there is no model, or the model is no pose auto-encoder of windows of 34 frames.
    """

    def __init__(self, source: str | os.PathLike):
        loaded = model_folder.load_path(source, _EXPECTED)
        generator = loaded.spec.generator
        if not isinstance(generator, PoseAutoencoder):
            raise UserError(
                f"{shown(source)} is a model of the method {loaded.spec.method}, not a pose auto-encoder; {_TRAIN_ONE}"
            )
        if loaded.spec.num_frames != WINDOW_FRAMES:
            raise UserError(
                f"{shown(source)} is a pose auto-encoder of windows of {loaded.spec.num_frames} frames, expected "
                f"{WINDOW_FRAMES}; {_TRAIN_ONE}"
            )
        self._spec, self._variables = loaded.spec, jax.device_put(loaded.variables)
        self.id = weights_id(loaded.variables)
        self.name: str = loaded.config.name
        self.data = pathlib.PurePath(loaded.config.data.path).name
        self.latent_dim = generator.latent_dim
        self.skeleton: Skeleton = loaded.spec.skeleton
        self.fps = float(loaded.config.data.fps)

    def __call__(self, windows: np.ndarray) -> np.ndarray:
        """Return latents (n, d) float64 of windows (n, 34, bones, 3) of unit direction vectors."""
        parts = [part.astype(np.float64) for part in self._batches(_encode, windows)]
        return np.concatenate([np.zeros((0, self.latent_dim)), *parts])

    def reconstruction_error(self, windows: np.ndarray) -> float:
        """Return the mean |x - decode(encode(x))| over all coordinates of mean-subtracted unit vectors."""
        errors = np.concatenate([np.zeros(0), *self._batches(_errors, windows)])
        return float(errors.mean()) if len(errors) else float("nan")

    def _batches(self, function: Callable[..., jax.Array], windows: np.ndarray) -> Iterator[np.ndarray]:
        for start in range(0, len(windows), _BATCH):
            part = np.asarray(windows[start : start + _BATCH], np.float32)
            filled = np.pad(part, ((0, _BATCH - len(part)), (0, 0), (0, 0), (0, 0)))
            yield np.asarray(function(self._spec, self._variables, filled))[: len(part)]


def weights_id(variables: dict[str, Any]) -> str:
    """Return the SHA-256 of parameters and statistics as float32, the same for a workdir and for a model folder."""
    flat = traverse_util.flatten_dict(variables, sep="/")
    arrays = {str(name): np.ascontiguousarray(array, np.float32) for name, array in flat.items()}
    return hashlib.sha256(safetensors.numpy.save(arrays)).hexdigest()


@functools.partial(jax.jit, static_argnums=0)
def _encode(spec: Spec, variables: dict[str, Any], windows: jax.Array) -> jax.Array:
    poses = subtract_mean(spec, jnp.asarray(windows))
    latents: Any = spec.generator.apply(variables, poses, train=False, method=PoseAutoencoder.encode)
    return latents


@functools.partial(jax.jit, static_argnums=0)
def _errors(spec: Spec, variables: dict[str, Any], windows: jax.Array) -> jax.Array:
    poses = subtract_mean(spec, jnp.asarray(windows))
    restored: Any = spec.generator.apply(variables, poses, train=False)
    return jnp.abs(restored - poses).mean(axis=(1, 2))
