"""A network on one batch, in the precision of the task.

Parameters are float32 everywhere outside of the modules. On the way in they and the inputs are rounded to
`task.dtype`, on the way out results are float32 again; so gradients, statistics and losses are float32 too.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from flax import linen as nn

from ha2g_jax.methods.task import Task, speech_arguments

Batch = dict[str, jax.Array]
Variables = dict[str, Any]


def apply(
    task: Task, module: nn.Module, variables: Variables, key: jax.Array, *args: Any, train: bool, method: Any = None
) -> tuple[Any, Any]:
    """Runs a module, or one of its methods.

    Args:
        task: decides on the precision.
        module: a network of the task.
        variables: {"params", "batch_stats"} of it.
        key: of the stream "dropout".
        args: what the method takes.
        train: as the method takes it; statistics move in training alone.
        method: name or function; `__call__` by default.

    Returns:
        The result in float32, and the batch statistics afterwards.
    """
    rounded = variables | {"params": _cast(variables["params"], task.dtype)}
    result, updates = module.apply(
        rounded,
        *_cast(args, task.dtype),
        mutable=["batch_stats"] if train else [],
        rngs={"dropout": key},
        train=train,
        method=method,
    )
    return _cast(result, jnp.dtype(jnp.float32)), updates.get("batch_stats", variables["batch_stats"])


class Poses(NamedTuple):
    """Outputs of a method whose objective looks at poses alone: one level, (B, N, pose_dim), mean-subtracted."""

    poses: tuple[jax.Array]


def run_generator(
    task: Task, variables: Variables, batch: Batch, keys: dict[str, jax.Array], *, train: bool = True
) -> tuple[Poses, tuple[Any, None]]:
    """`Method.run` of a generator that needs nothing but a call on a batch.

    Args:
        task: static.
        variables: {"params", "batch_stats"} of the generator.
        batch: as in `train_step`.
        keys: "dropout".
        train: False is evaluation mode.

    Returns:
        The outputs, and (batch statistics after the run, None).
    """
    arguments = speech_arguments(task, batch)
    poses, batch_stats = apply(task, task.generator, variables, keys["dropout"], *arguments, train=train)
    return Poses(poses), (batch_stats, None)


def discriminate(
    task: Task, variables: Variables, poses: jax.Array, key: jax.Array, *, train: bool = True
) -> tuple[jax.Array, Any]:
    """Logits (B, ...) of poses (B, N, pose_dim), and the batch statistics after this pass."""
    return apply(task, task.discriminator, variables, key, poses, train=train)


def _cast(tree: Any, dtype: jnp.dtype) -> Any:
    """Floating numbers and bytes of pixels as `dtype`; bfloat16 has all numbers of a byte. Indices stay."""

    def cast(x: jax.Array) -> jax.Array:
        return x.astype(dtype) if jnp.issubdtype(x.dtype, jnp.floating) or x.dtype == jnp.uint8 else x

    return jax.tree.map(cast, tree)
