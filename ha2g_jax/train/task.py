"""What is trained: both networks, their optimisers and the weights of the objective, built from a config.

This is the only place that reads `config.model` and `config.loss`, the settings of `config.train` that decide on
an update, and the one place of decision D1.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax

from ha2g_jax import models
from ha2g_jax.audio import NUM_MELS, WINDOW_COLUMNS
from ha2g_jax.config import Config
from ha2g_jax.errors import UserError
from ha2g_jax.skeleton import Skeleton, normalize
from ha2g_jax.train.optimizers import SCHEDULES, adam, learning_rate

TERMS = ("gan", "huber", "physical", "style", "kld", "contrastive")
# The key of the batch that E_ID reads, for each kind of identity.
_IDENTITY_INPUTS = {"images": "frames", "speakers": "speaker"}
_GAN_KINDS = ("non_saturating", "minimax")
_DTYPES = ("float32", "bfloat16")


@dataclasses.dataclass(frozen=True)
class LossSettings:
    """Weights of the terms of Eq. 9, as (name, weight) of each of `TERMS`, and the terms' own numbers."""

    weights: tuple[tuple[str, float], ...]
    huber_delta: float
    gan: str
    temperature: float
    style_clip: float


# Compared and hashed by identity: it holds arrays, and is a static argument of compiled functions.
@dataclasses.dataclass(frozen=True, eq=False)
class Task:
    """Everything about training that does not change from step to step.

    Attributes:
        generator, discriminator: the modules.
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
        identity_input: "frames" or "speaker", the key of the batch that E_ID reads.
        image_size: of the reference frames.
        word_vectors: (words, embedding_dim) the word table starts from, or None.
    """

    generator: models.HA2G
    discriminator: models.Discriminator
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
    identity_input: str
    image_size: int
    word_vectors: np.ndarray | None


def build_task(
    config: Config,
    skeleton: Skeleton,
    vocabulary_size: int,
    num_speakers: int,
    *,
    steps_per_epoch: int = 0,
    word_vectors: np.ndarray | None = None,
) -> Task:
    """The task of a config on a data set.

    Args:
        config: a ConfigDict with the fields of `ha2g_jax.config.paper`.
        skeleton: with the statistics of the training split.
        vocabulary_size, num_speakers: of the training split; where windows are mirrored, a table of speakers has
            as many rows again for their mirror images, in the same order.
        steps_per_epoch: turns `config.train.warmup_epochs` into steps; only training needs it.
        word_vectors: (vocabulary_size, embedding_dim) to start the word table from.

    Raises:
        UserError: a loss weight that names no term, a term without a weight, an unknown choice, a number that
            makes no sense, or word vectors of another size than the table.
    """
    _check_numbers(config.train)
    kind = _choice("model.identity.kind", config.model.identity.kind, tuple(_IDENTITY_INPUTS))
    table = (vocabulary_size, config.model.text.embedding_dim)
    if word_vectors is not None and word_vectors.shape != table:
        raise UserError(
            f"word vectors have shape {word_vectors.shape}, expected {table}: "
            f"set --config.model.text.embedding_dim={word_vectors.shape[-1]}"
        )
    train = config.train
    schedule = _choice("train.schedule", train.schedule, SCHEDULES)
    generator_rate = learning_rate(schedule, train.learning_rate, train.steps)
    discriminator_rate = learning_rate(schedule, train.discriminator_learning_rate, train.steps)
    return Task(
        generator=_generator(config, skeleton, vocabulary_size, num_speakers),
        discriminator=models.Discriminator(
            hidden_dim=config.model.discriminator.hidden_dim, layers=config.model.discriminator.layers
        ),
        generator_optimizer=adam(generator_rate, train.betas, train.clip_norm),
        discriminator_optimizer=adam(discriminator_rate, train.betas, train.clip_norm),
        generator_rate=generator_rate,
        discriminator_rate=discriminator_rate,
        losses=_loss_settings(config.loss),
        warmup_steps=train.warmup_epochs * steps_per_epoch,
        average_decay=train.ema,
        dtype=jnp.dtype(_choice("train.dtype", train.dtype, _DTYPES)),
        num_parts=train.accumulate,
        skeleton=skeleton,
        num_frames=config.data.num_frames,
        num_seed_frames=config.data.num_seed_frames,
        identity_input=_IDENTITY_INPUTS[kind],
        image_size=config.data.image_size,
        word_vectors=word_vectors,
    )


def _generator(config: Config, skeleton: Skeleton, vocabulary_size: int, num_speakers: int) -> models.HA2G:
    audio, text, identity, inferer = (config.model[part] for part in ("audio", "text", "identity", "inferer"))
    is_recomputed = config.train.accumulate > 1
    if identity.kind == "images":
        identity_encoder = models.ImageIdentity(
            width=identity.width, feature_dim=identity.feature_dim, is_recomputed=is_recomputed
        )
    else:
        num_rows = 2 * num_speakers if config.data.mirror else num_speakers
        identity_encoder = models.SpeakerIdentity(num_speakers=num_rows, feature_dim=identity.feature_dim)
    return models.HA2G(
        audio=models.AudioEncoder(
            blocks=tuple(audio.blocks),
            channels=tuple(audio.channels),
            stem_stride=tuple(audio.stem_stride),
            feature_dim=audio.feature_dim,
            is_recomputed=is_recomputed,
        ),
        text=models.TextEncoder(
            vocabulary_size=vocabulary_size,
            embedding_dim=text.embedding_dim,
            channels=text.channels,
            layers=text.layers,
            feature_dim=audio.feature_dim,  # Eq. 2 compares the two
            receptive_field=_choice("model.text.receptive_field", text.receptive_field, ("centred", "causal")),
            dropout=text.dropout,
        ),
        identity=identity_encoder,
        level_channels=skeleton.level_channels,
        num_seed_frames=config.data.num_seed_frames,
        hidden_dim=inferer.hidden_dim,
        layers=inferer.layers,
        dropout=inferer.dropout,
    )


def _loss_settings(loss: Config) -> LossSettings:
    names = set(loss.weights)
    if names != set(TERMS):
        odd = ", ".join(sorted(names ^ set(TERMS)))
        raise UserError(f"config.loss.weights and the terms of the objective differ in {odd}: weigh {', '.join(TERMS)}")
    return LossSettings(
        weights=tuple((name, float(loss.weights[name])) for name in TERMS),
        huber_delta=loss.huber_delta,
        gan=_choice("loss.gan", loss.gan, _GAN_KINDS),
        temperature=loss.temperature,
        style_clip=loss.style_clip,
    )


def _choice(field: str, value: str, choices: tuple[str, ...]) -> str:
    if value not in choices:
        raise UserError(f"config.{field} is {value!r}, expected one of {', '.join(choices)}: set --config.{field}")
    return value


def _check_numbers(train: Config) -> None:
    expected = {
        "ema": ("from 0 to below 1", 0 <= train.ema < 1),
        "clip_norm": ("0 or more", train.clip_norm >= 0),
        "accumulate": (
            f"a divisor of config.train.batch_size, {train.batch_size}",
            train.accumulate >= 1 and train.batch_size % train.accumulate == 0,
        ),
    }
    for name, (range_, is_met) in expected.items():
        if not is_met:
            raise UserError(f"config.train.{name} is {train[name]}, expected {range_}: set --config.train.{name}")


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


def split_levels(task: Task, poses: jax.Array) -> tuple[jax.Array, ...]:
    """Flat poses (..., pose_dim) as the H levels of the hierarchy, each (..., d^h)."""
    return tuple(poses[..., np.array(channels)] for channels in task.skeleton.level_channels)


def example_batch(task: Task) -> dict[str, jax.Array]:
    """A batch of one empty window, in the shapes of a real one."""
    return {
        "mel": jnp.zeros((1, NUM_MELS, WINDOW_COLUMNS)),
        "words": jnp.zeros((1, task.num_frames), jnp.int32),
        "directions": jnp.zeros((1, task.num_frames, task.skeleton.num_bones, 3)),
        "speaker": jnp.zeros((1,), jnp.int32),
        "frames": jnp.zeros((1, task.num_seed_frames, task.image_size, task.image_size, 3), jnp.uint8),
    }


def set_word_vectors(task: Task, variables: Mapping[str, Any]) -> Mapping[str, Any]:
    """The generator's variables with the task's word vectors in their table; unchanged where it has none."""
    if task.word_vectors is None:
        return variables
    params = variables["params"]
    text = {**params["text"], "embedding": {"embedding": jnp.asarray(task.word_vectors, jnp.float32)}}
    return {**variables, "params": {**params, "text": text}}
