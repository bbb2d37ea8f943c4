"""A task from a config: the one place that reads `config.loss` and the settings of `config.train` about an update.

What `config.model` says, the method itself reads.
"""

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np

from ha2g_jax.config import Config
from ha2g_jax.errors import UserError
from ha2g_jax.methods import METHODS
from ha2g_jax.methods.adversarial import GAN_KINDS
from ha2g_jax.methods.choices import choice, some_of
from ha2g_jax.methods.ha2g.losses import AUDIO_LEVELS
from ha2g_jax.methods.task import LossSettings, Method, Task
from ha2g_jax.skeleton import Skeleton
from ha2g_jax.train.optimizers import SCHEDULES, adam, learning_rate

# The key of the batch that the identity is read from, for each kind of identity.
_IDENTITY_INPUTS = {"images": "frames", "speakers": "speaker", "none": ""}
_DTYPES = ("float32", "bfloat16")


def build_task(
    config: Config,
    skeleton: Skeleton,
    vocabulary_size: int,
    num_speakers: int,
    *,
    steps_per_epoch: int = 0,
    pretrained: Mapping[str, Any] | None = None,
) -> Task:
    """The task of a config on a data set.

    Args:
        config: a ConfigDict with the fields of `ha2g_jax.config.paper`.
        skeleton: with the statistics of the training split.
        vocabulary_size, num_speakers: of the training split; where windows are mirrored, a table of speakers has
            as many rows again for their mirror images, in the same order.
        steps_per_epoch: turns `config.train.warmup_epochs` into steps; only training needs it.
        pretrained: parameters to start from, see `Task`.

    Raises:
        UserError: a loss weight that names no term, a term without a weight, an unknown choice, or a number that
            makes no sense.
    """
    _check_numbers(config.train)
    method = find_method(config)
    if config.train.accumulate > 1 and not method.has_parts:
        raise UserError(
            f"config.train.accumulate is {config.train.accumulate}, but {config.method} takes a batch whole: "
            "set --config.train.accumulate=1"
        )
    kind = choice("model.identity.kind", config.model.identity.kind, tuple(_IDENTITY_INPUTS))
    train = config.train
    schedule = choice("train.schedule", train.schedule, SCHEDULES)
    generator_rate = learning_rate(schedule, train.learning_rate, train.steps)
    discriminator_rate = learning_rate(schedule, train.discriminator_learning_rate, train.steps)
    networks = method.build(config, skeleton, vocabulary_size, num_speakers)
    return Task(
        method=method,
        generator=networks.generator,
        discriminator=networks.discriminator,
        generator_optimizer=adam(generator_rate, train.betas, train.clip_norm),
        discriminator_optimizer=adam(discriminator_rate, train.betas, train.clip_norm),
        generator_rate=generator_rate,
        discriminator_rate=discriminator_rate,
        losses=_loss_settings(config.loss, method.terms),
        warmup_steps=train.warmup_epochs * steps_per_epoch,
        average_decay=train.ema,
        dtype=jnp.dtype(choice("train.dtype", train.dtype, _DTYPES)),
        num_parts=train.accumulate,
        skeleton=skeleton,
        num_frames=config.data.num_frames,
        num_seed_frames=config.data.num_seed_frames,
        inputs=method.inputs(config),
        identity_input=_IDENTITY_INPUTS[kind],
        num_reference_frames=config.data.num_reference_frames,
        image_size=config.data.image_size,
        pretrained=pretrained or {},
    )


def find_method(config: Config) -> Method:
    """The method that a config names.

    Raises:
        UserError: there is none of this name.
    """
    return METHODS[choice("method", config.method, tuple(METHODS))]


def word_table(config: Config, vocabulary_size: int, word_vectors: np.ndarray) -> dict[str, Any]:
    """`Task.pretrained` of a generator whose table of words starts from word vectors (words, embedding_dim).

    Raises:
        UserError: they have another size than the table.
    """
    table = (vocabulary_size, config.model.text.embedding_dim)
    if word_vectors.shape != table:
        raise UserError(
            f"word vectors have shape {word_vectors.shape}, expected {table}: "
            f"set --config.model.text.embedding_dim={word_vectors.shape[-1]}"
        )
    return {"text": {"embedding": {"embedding": word_vectors}}}


def _loss_settings(loss: Config, terms: tuple[str, ...]) -> LossSettings:
    if odd := sorted(set(loss.weights) ^ set(terms)):
        raise UserError(
            f"config.loss.weights and the terms of the objective differ in {', '.join(odd)}: weigh {', '.join(terms)}"
        )
    return LossSettings(
        weights=tuple((name, float(loss.weights[name])) for name in terms),
        huber_delta=loss.huber_delta,
        gan=choice("loss.gan", loss.gan, GAN_KINDS),
        temperature=loss.temperature,
        negatives=some_of("loss.negatives", loss.negatives, AUDIO_LEVELS),
        style_clip=loss.style_clip,
    )


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
