"""Initial values with the distributions of PyTorch's kernels and GRUs, drawn by NumPy on the host.

On a CPU, a program that draws each parameter with `jax.random` takes as long to compile as a training step. These
initializers take a key and a shape as those of Flax do, but add only a host callback to the program.
"""

import functools
import math
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

# A function (key, shape, dtype=float32) that returns an array, as Flax modules expect.
Initializer: TypeAlias = Callable[..., jax.Array]


def uniform(bound: float) -> Initializer:
    """Return an initializer of values that are uniform in +-bound."""
    return functools.partial(_draw, lambda random, shape: random.uniform(-bound, bound, shape))


def normal(deviation: float) -> Initializer:
    """Return an initializer of values that are normal around 0 with a standard deviation."""
    return functools.partial(_draw, lambda random, shape: random.normal(0.0, deviation, shape))


def linear(gain: float = 1.0) -> Initializer:
    """Return an initializer of kernels (..., inputs, outputs) that are uniform in +-gain / sqrt(fan in)."""

    def draw(random: np.random.Generator, shape: Sequence[int]) -> np.ndarray:
        bound = gain / math.sqrt(math.prod(shape[:-1]))
        return random.uniform(-bound, bound, shape)

    return functools.partial(_draw, draw)


def _kaiming(random: np.random.Generator, shape: Sequence[int]) -> np.ndarray:
    fan_out = math.prod(shape[:-2]) * shape[-1]
    return random.normal(0.0, math.sqrt(2 / fan_out), shape)


def _draw(draw: Callable, key: jax.Array, shape: Sequence[int], dtype: Any = jnp.float32) -> jax.Array:
    def host(data: jax.Array) -> np.ndarray:
        words = np.asarray(data)[:2].astype(np.uint64)  # keys of other generators than JAX's default have more
        random = np.random.Generator(np.random.Philox(key=words))
        return draw(random, tuple(shape)).astype(dtype)

    result = jax.ShapeDtypeStruct(tuple(shape), dtype)
    return jax.pure_callback(host, result, jax.random.key_data(key), vmap_method="sequential")


# Uniform in +-1/sqrt(fan in): kernels of torch.nn.Linear and torch.nn.Conv1d.
LINEAR = linear()

# Kaiming normal, fan out, gain of ReLU: kernels of the convolutions of the ResNets.
RESNET = functools.partial(_draw, _kaiming)
