"""Run a network on a batch in the precision of a training step.

Parameters are float32 everywhere outside of the modules. On entry they and the inputs are rounded to `Compute.dtype`,
on exit results are float32 again, so that gradients, statistics and losses are float32 too.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from flax import linen as nn

from ha2g_jax.methods.method import FLOAT32, Batch, Compute, Spec, Variables, speech_arguments


def apply(
    module: nn.Module,
    variables: Variables,
    key: jax.Array,
    *args: Any,
    train: bool,
    compute: Compute,
    method: Any = None,
) -> tuple[Any, Any]:
    """Run a module, or one of its methods.

    Args:
        module: network of a spec.
        variables: {"params", "batch_stats"} of the module.
        key: key of the random stream "dropout".
        args: arguments of the method.
        train: whether to run in training mode, in which statistics move.
        compute: precision of the activations.
        method: function that takes the bound module first; `__call__` by default.

    Returns:
        The result in float32, and the batch statistics afterwards.
    """
    rounded = variables | {"params": _cast(variables["params"], compute.dtype)}
    result, updates = module.apply(
        rounded,
        *_cast(args, compute.dtype),
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
    spec: Spec,
    variables: Variables,
    batch: Batch,
    keys: dict[str, jax.Array],
    *,
    train: bool = True,
    compute: Compute = FLOAT32,
) -> tuple[Poses, tuple[Any, None]]:
    """Run a generator that needs nothing but a call on a batch; see `Method.run`.

    Args:
        spec: static.
        variables: {"params", "batch_stats"} of the generator.
        batch: arrays as in `ha2g_jax.train.step.train_step`.
        keys: the key "dropout".
        train: whether to run in training mode; False is evaluation mode.
        compute: precision of the activations.

    Returns:
        The outputs, and (batch statistics after the run, None).
    """
    arguments = speech_arguments(spec, batch)
    poses, batch_stats = apply(spec.generator, variables, keys["dropout"], *arguments, train=train, compute=compute)
    return Poses(poses), (batch_stats, None)


def discriminate(
    spec: Spec,
    variables: Variables,
    poses: jax.Array,
    key: jax.Array,
    *,
    train: bool = True,
    compute: Compute = FLOAT32,
) -> tuple[jax.Array, Any]:
    """Return logits (B, ...) of poses (B, N, pose_dim), and the batch statistics after this pass."""
    return apply(spec.discriminator, variables, key, poses, train=train, compute=compute)


def _cast(tree: Any, dtype: jnp.dtype) -> Any:
    """Return floating numbers and bytes of pixels as `dtype`; bfloat16 holds every byte exactly. Indices stay."""

    def cast(x: jax.Array) -> jax.Array:
        return x.astype(dtype) if jnp.issubdtype(x.dtype, jnp.floating) or x.dtype == jnp.uint8 else x

    return jax.tree.map(cast, tree)
