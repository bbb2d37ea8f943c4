"""What is trained: a method with its networks, optimisers and the weights of its objective.

`train.building` makes a `Task` from a config; this file is the one place of decision D1.
"""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax
from flax import linen as nn

from ha2g_jax.features.asr_mel import ASR_COLUMNS, NUM_ASR_MELS
from ha2g_jax.features.audio import NUM_MELS, WINDOW_COLUMNS, WINDOW_SAMPLES
from ha2g_jax.features.text import MAX_PLAIN_WORDS
from ha2g_jax.skeleton import Skeleton, normalize


class Networks(NamedTuple):
    """The modules of a method; `discriminator` is None where it has no adversarial term."""

    generator: nn.Module
    discriminator: nn.Module | None


def speech_arguments(task: Any, batch: Mapping[str, jax.Array]) -> tuple[Any, ...]:
    """What a generator is called with to run every part once: speech, identity and seed pose of a batch."""
    inputs = {name: batch[name] for name in task.inputs}
    seed = subtract_mean(task, batch["directions"])[:, : task.num_seed_frames]
    return inputs, batch[task.identity_input] if task.identity_input else None, seed


class Method(NamedTuple):
    """How a method is built, run and judged; one in each file of `train.methods`.

    Attributes:
        terms: names of its objective's terms; "gan" is one of them if and only if it has a discriminator.
        inputs: from a config, what a training example has of the speech; names as in `data.speech`.
        build: (config, skeleton, vocabulary_size, num_speakers) -> Networks.
        run: (task, variables, batch, keys, *, train) -> (outputs, (batch statistics, aux)). The objective is
            differentiated by `outputs`, a NamedTuple whose field `poses` ends with (B, N, pose_dim), but not by `aux`.
        loss_terms: (task, outputs, aux, targets) -> the unweighted terms but "gan"; targets are the true poses
            (B, N, pose_dim), mean-subtracted.
        arguments: (task, batch) -> what the generator is initialised with.
        has_parts: whether `run` can take the batch in `task.num_parts` parts.
    """

    terms: tuple[str, ...]
    inputs: Callable[..., tuple[str, ...]]
    build: Callable[..., Networks]
    run: Callable[..., tuple[Any, tuple[Any, Any]]]
    loss_terms: Callable[..., dict[str, jax.Array]]
    arguments: Callable[..., tuple[Any, ...]] = speech_arguments
    has_parts: bool = False


@dataclasses.dataclass(frozen=True)
class LossSettings:
    """Weights of the terms, as (name, weight) of each of the method's, and the terms' own numbers."""

    weights: tuple[tuple[str, float], ...]
    huber_delta: float
    gan: str
    temperature: float
    negatives: tuple[str, ...]
    style_clip: float


# Compared and hashed by identity: it holds arrays, and is a static argument of compiled functions.
@dataclasses.dataclass(frozen=True, eq=False)
class Task:
    """Everything about training that does not change from step to step.

    Attributes:
        method: what the networks are for.
        generator, discriminator: the modules; a method without an adversarial term has no discriminator.
        generator_optimizer, discriminator_optimizer: Adam behind the limit of the gradient's norm; their `update`
            may take `step=`.
        generator_rate, discriminator_rate: the learning rates at a step.
        losses: weights and numbers of the objective.
        warmup_steps: steps before the GAN term (D9).
        average_decay: most that the running average of the generator keeps in a step; 0 for no average.
        dtype: of activations in training. Parameters are float32 in any case, and so is all of synthesis.
        num_parts: parts of the batch that go through the pose inferer one after the other.
        skeleton: with the mean directions and angle statistics of the training split.
        num_frames, num_seed_frames: N and M.
        inputs: what a training example has of the speech.
        identity_input: "frames" or "speaker", the key of the batch that the identity is read from; "" for a method
            that knows no identity.
        num_reference_frames, image_size: of the images that the identity is read from.
        pretrained: parameters, as a part of the generator's tree, that training starts from.
    """

    method: Method
    generator: Any
    discriminator: Any
    generator_optimizer: optax.GradientTransformation
    discriminator_optimizer: optax.GradientTransformation
    generator_rate: optax.Schedule
    discriminator_rate: optax.Schedule
    losses: LossSettings
    warmup_steps: int
    average_decay: float
    dtype: jnp.dtype
    num_parts: int
    skeleton: Skeleton
    num_frames: int
    num_seed_frames: int
    inputs: tuple[str, ...]
    identity_input: str
    num_reference_frames: int
    image_size: int
    pretrained: Mapping[str, Any]


def subtract_mean(task: Task, directions: jax.Array) -> jax.Array:
    """Direction vectors (..., bones, 3) to what networks see (D1): less their mean, flat, (..., pose_dim)."""
    mean = jnp.asarray(task.skeleton.mean_directions)
    centred = directions - jnp.expand_dims(mean, tuple(range(directions.ndim - 2)))
    return centred.reshape(*directions.shape[:-2], task.skeleton.pose_dim)


def restore(task: Task, poses: jax.Array) -> jax.Array:
    """The way back (D1): flat poses (..., pose_dim) plus the mean, as unit vectors (..., bones, 3)."""
    mean = jnp.asarray(task.skeleton.mean_directions)
    vectors = poses.reshape(*poses.shape[:-1], task.skeleton.num_bones, 3)
    return normalize(vectors + jnp.expand_dims(mean, tuple(range(vectors.ndim - 2))))


def example_batch(task: Task) -> dict[str, jax.Array]:
    """A batch of one empty window, in the shapes of a real one."""
    shapes = {
        "mel": ((1, NUM_MELS, WINDOW_COLUMNS), jnp.float32),
        "asr_mel": ((1, NUM_ASR_MELS, ASR_COLUMNS), jnp.float32),
        "audio": ((1, WINDOW_SAMPLES), jnp.float32),
        "words": ((1, task.num_frames), jnp.int32),
        "plain_words": ((1, MAX_PLAIN_WORDS), jnp.int32),
    }
    batch = {name: jnp.zeros(*shapes[name]) for name in task.inputs}
    batch |= {
        "directions": jnp.zeros((1, task.num_frames, task.skeleton.num_bones, 3)),
        "speaker": jnp.zeros((1,), jnp.int32),
    }
    if task.identity_input == "frames":
        shape = (1, task.num_reference_frames, task.image_size, task.image_size, 3)
        batch["frames"] = jnp.zeros(shape, jnp.uint8)
    return batch


def set_pretrained(task: Task, variables: Mapping[str, Any]) -> Mapping[str, Any]:
    """The generator's variables with the task's pretrained parameters in place of fresh ones."""
    return {**variables, "params": _merge(variables["params"], task.pretrained)}


def _merge(tree: Any, part: Any) -> Any:
    if not isinstance(part, Mapping):
        # Of a table with more rows, such as Seq2Seq's with its marks of a sentence, the others stay fresh.
        return tree.at[: len(part)].set(jnp.asarray(part, jnp.float32))
    return {**tree, **{name: _merge(tree[name], value) for name, value in part.items()}}
