"""Both networks on one batch, in the precision and in the number of parts of the task.

Parameters are float32 everywhere outside of the modules. On the way in they and the inputs are rounded to
`task.dtype`, on the way out results are float32 again; so gradients, statistics and losses are float32 too.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from flax import linen as nn

from ha2g_jax.models import HA2G
from ha2g_jax.train.task import Task, subtract_mean

Batch = dict[str, jax.Array]
Variables = dict[str, Any]


class Outputs(NamedTuple):
    """What the objective is differentiated by.

    Attributes:
        poses: H arrays (B, N, d^h), mean-subtracted.
        features: low, mid and high audio features, each (B, N, 32).
        text: (B, N, 32) text features.
        mean, log_variance: (B, 18) of the identity.
    """

    poses: tuple[jax.Array, ...]
    features: tuple[jax.Array, jax.Array, jax.Array]
    text: jax.Array
    mean: jax.Array
    log_variance: jax.Array


class Contrast(NamedTuple):
    """The same speech with another identity of the batch; no gradient flows through it.

    Attributes:
        poses: (B, N, pose_dim) of the last level.
        f_id: (B, 18) identity of `Outputs.poses`.
        other_f_id: (B, 18) identity of `poses`.
    """

    poses: jax.Array
    f_id: jax.Array
    other_f_id: jax.Array


def generate(
    task: Task, variables: Variables, batch: Batch, keys: dict[str, jax.Array], *, train: bool = True
) -> tuple[Outputs, tuple[Any, Contrast]]:
    """The generator on one batch, for its own identities and, in the same run, for a permutation of them.

    Audio, text and identity are encoded once, for the whole batch, whose statistics BatchNorm takes. The pose
    inferer treats each clip by itself, so that in training it can take the batch in `task.num_parts` parts.

    Args:
        task: static.
        variables: {"params", "batch_stats"} of the generator.
        batch: as in `train_step`.
        keys: "dropout", "identity" and "permutation".
        train: False is evaluation mode, with the mean of each identity instead of a sample.

    Returns:
        The outputs, and (batch statistics after the run, the run with the other identities).
    """
    inputs = (batch["mel"], batch["words"], batch[task.identity_input])
    (features, text, (mean, log_variance)), batch_stats = _apply(
        task, task.generator, variables, keys["dropout"], *inputs, train=train, method=_encode
    )
    f_id = mean
    if train:
        f_id = mean + jnp.exp(0.5 * log_variance) * jax.random.normal(keys["identity"], mean.shape)
    # A turn of the batch: a permutation in which no clip, unless alone, keeps its own identity.
    turn = jax.random.randint(keys["permutation"], (), 1, max(len(mean), 2))
    other_f_id = jax.lax.stop_gradient(jnp.roll(f_id, turn, axis=0))
    seed = subtract_mean(task, batch["directions"])[:, : task.num_seed_frames]

    def infer(key: jax.Array, clips: Any) -> tuple[jax.Array, ...]:
        return _infer_both(task, variables, key, *clips, train=train)

    clips = (tuple(features), f_id, other_f_id, seed)
    if train and task.num_parts > 1:
        pairs = _in_parts(infer, task.num_parts, keys["dropout"], clips)
    else:
        pairs = infer(keys["dropout"], clips)
    outputs = Outputs(tuple(pair[:, 0] for pair in pairs), tuple(features), text, mean, log_variance)
    return outputs, (batch_stats, Contrast(pairs[-1][:, 1], f_id, other_f_id))


def discriminate(
    task: Task, variables: Variables, poses: jax.Array, key: jax.Array, *, train: bool = True
) -> tuple[jax.Array, Any]:
    """Logits (B,) of poses (B, N, pose_dim), and the batch statistics after this pass."""
    return _apply(task, task.discriminator, variables, key, poses, train=train)


def _encode(model: HA2G, mel: jax.Array, words: jax.Array, identity: jax.Array, *, train: bool) -> Any:
    return (
        model.encode_audio(mel, train=train),
        model.encode_text(words, train=train),
        model.encode_identity(identity, train=train),
    )


def _infer_both(
    task: Task,
    variables: Variables,
    key: jax.Array,
    features: tuple[jax.Array, ...],
    f_id: jax.Array,
    other_f_id: jax.Array,
    seed: jax.Array,
    *,
    train: bool,
) -> tuple[jax.Array, ...]:
    """Per level (B, 2, N, d^h): the poses with the own and with the other identity.

    The two of a clip lie side by side on the batch axis of the pose inferer, so that a batch split over devices
    stays where it is.
    """
    both = jnp.stack([f_id, other_f_id], axis=1).reshape(2 * len(seed), -1)
    *twice, seeds = (jnp.repeat(array, 2, axis=0) for array in (*features, seed))
    levels, _ = _apply(task, task.generator, variables, key, tuple(twice), both, seeds, train=train, method="infer")
    return tuple(level.reshape(len(seed), 2, *level.shape[1:]) for level in levels)


def _in_parts(function: Any, count: int, key: jax.Array, clips: Any) -> Any:
    """`function(key, clips)` for one part of the clips after the other.

    What a part has computed on its way is not kept, but computed again when the gradient needs it. Part p has clips
    p, p + count, ...: as the clips of a device lie side by side, it takes as many of each, and none moves.
    """

    def part(_: None, inputs: Any) -> tuple[None, Any]:
        return None, function(*inputs)

    def divide(x: jax.Array) -> jax.Array:
        return jnp.moveaxis(x.reshape(len(x) // count, count, *x.shape[1:]), 1, 0)

    def join(x: jax.Array) -> jax.Array:
        return jnp.moveaxis(x, 0, 1).reshape(-1, *x.shape[2:])

    inputs = (jax.random.split(key, count), jax.tree.map(divide, clips))
    # The loop itself keeps the two passes apart; the barriers that do it elsewhere would only cost.
    return jax.tree.map(join, jax.lax.scan(jax.checkpoint(part, prevent_cse=False), None, inputs)[1])


def _apply(
    task: Task, module: nn.Module, variables: Variables, key: jax.Array, *args: Any, train: bool, method: Any = None
) -> tuple[Any, Any]:
    """Result in float32 and batch statistics, those of `variables` unless in training."""
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


def _cast(tree: Any, dtype: jnp.dtype) -> Any:
    """Floating numbers and bytes of pixels as `dtype`; bfloat16 has all numbers of a byte. Indices stay."""

    def cast(x: jax.Array) -> jax.Array:
        return x.astype(dtype) if jnp.issubdtype(x.dtype, jnp.floating) or x.dtype == jnp.uint8 else x

    return jax.tree.map(cast, tree)
