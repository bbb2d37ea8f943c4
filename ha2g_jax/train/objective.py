"""The objective of a training run: weights, optimisers, warm-up and accumulation, and the state that it starts from.

This module alone reads `config.loss` and those settings of `config.train` that define the update.
"""

import dataclasses
import functools
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import optax

from ha2g_jax.checkpoint.state import Network, TrainState
from ha2g_jax.config.choices import choice
from ha2g_jax.config.settings import Config
from ha2g_jax.errors import UserError
from ha2g_jax.methods.adversarial import GAN_KINDS
from ha2g_jax.methods.build import build, method_of
from ha2g_jax.methods.method import Compute, Spec, example_batch
from ha2g_jax.skeleton import Skeleton
from ha2g_jax.train.optimizers import SCHEDULES, adam, learning_rate

_DTYPES = ("float32", "bfloat16")
# Settings of `config.loss.<method>` that every method has or may have; the others are the method's own.
_COMMON_LOSS_SETTINGS = ("weights", "gan")


@dataclasses.dataclass(frozen=True)
class Objective:
    """Everything about training that does not change from step to step; equal objectives are equal static arguments.

    Attributes:
        spec: networks and sizes.
        weights: (name, weight) of each term of the loss.
        settings: settings of the terms, as `Method.terms` takes them.
        gan: kind of the adversarial loss, one of `GAN_KINDS`.
        generator_optimizer, discriminator_optimizer: Adam, after clipping of the gradient's norm; their `update` takes
            `step=`.
        generator_rate, discriminator_rate: learning rate at a step.
        warmup_steps: steps before the GAN term is used (D9).
        average_decay: largest decay of the running average of the generator in a step; 0 for no average.
        compute: precision of the activations, and number of parts of a batch.
    """

    spec: Spec
    weights: tuple[tuple[str, float], ...]
    settings: Any
    gan: str
    generator_optimizer: optax.GradientTransformation
    discriminator_optimizer: optax.GradientTransformation
    generator_rate: optax.Schedule
    discriminator_rate: optax.Schedule
    warmup_steps: int
    average_decay: float
    compute: Compute


def build_objective(
    config: Config, skeleton: Skeleton, vocabulary_size: int, num_speakers: int, *, steps_per_epoch: int = 0
) -> Objective:
    """Build the networks of a config and the objective that trains them.

    Args:
        config: settings, with the fields of `ha2g_jax.config.settings.paper`.
        skeleton, vocabulary_size, num_speakers: see `ha2g_jax.methods.build.build`.
        steps_per_epoch: number of steps in an epoch, by which `config.train.warmup_epochs` becomes a number of steps.

    Raises:
        UserError: a loss weight that names no term, a term without a weight, an unknown choice, or a number outside
            its range.
    """
    train = config.train
    _check_numbers(train)
    if train.accumulate > 1 and not config.model.recompute:
        config = config.copy_and_resolve_references()
        config.unlock()
        config.model.recompute = True  # accumulation is meant to save memory
    spec = build(config, skeleton, vocabulary_size, num_speakers)
    method = method_of(spec)
    if train.accumulate > 1 and not method.has_parts:
        raise UserError(
            f"config.train.accumulate is {train.accumulate}, but {config.method} cannot take a batch in parts: "
            "set --config.train.accumulate=1"
        )
    loss = loss_config(config)
    schedule = choice("train.schedule", train.schedule, SCHEDULES)
    generator_rate = learning_rate(schedule, train.learning_rate, train.steps)
    discriminator_rate = learning_rate(schedule, train.discriminator_learning_rate, train.steps)
    own = {name: value for name, value in loss.items() if name not in _COMMON_LOSS_SETTINGS}
    return Objective(
        spec=spec,
        weights=_weights(config.method, loss.weights, method.term_names),
        settings=method.loss_settings(own),
        gan=choice(f"loss.{config.method}.gan", loss.gan, GAN_KINDS) if "gan" in method.term_names else "",
        generator_optimizer=adam(generator_rate, tuple(train.betas), train.clip_norm),
        discriminator_optimizer=adam(discriminator_rate, tuple(train.betas), train.clip_norm),
        generator_rate=generator_rate,
        discriminator_rate=discriminator_rate,
        warmup_steps=train.warmup_epochs * steps_per_epoch,
        average_decay=train.ema,
        compute=Compute(jnp.dtype(choice("train.dtype", train.dtype, _DTYPES)), train.accumulate),
    )


def loss_config(config: Config) -> Config:
    """Return `config.loss.<method>`.

    Args:
        config: settings of the run.

    Raises:
        UserError: the config has no losses of its method.
    """
    if config.method not in config.loss:
        raise UserError(
            f"the config has no losses of {config.method}, only of {', '.join(config.loss) or 'no method'}: start from "
            f"its preset, {config.method}:DATA"
        )
    return config.loss[config.method]


@functools.partial(jax.jit, static_argnums=0)
def init_state(objective: Objective, key: jax.Array, pretrained: Mapping[str, Any] | None = None) -> TrainState:
    """Initialise the networks, their optimisers and the average.

    Args:
        objective: static.
        key: key of the random parameters.
        pretrained: part of the tree {"params", "batch_stats"} of the generator whose values replace the initial ones.

    Returns:
        The state before the first step.
    """
    spec = objective.spec
    generator_key, discriminator_key = jax.random.split(key)
    arguments = method_of(spec).init_arguments(spec, example_batch(spec))
    variables = spec.generator.init(generator_key, *arguments, train=False)
    generator = _network(set_pretrained(variables, pretrained or {}), objective.generator_optimizer)
    discriminator = None
    if spec.discriminator is not None:
        poses = jnp.zeros((1, spec.num_frames, spec.skeleton.pose_dim))
        variables = spec.discriminator.init(discriminator_key, poses, train=False)
        discriminator = _network(variables, objective.discriminator_optimizer)
    return TrainState(
        step=jnp.zeros((), jnp.int32),
        generator=generator,
        discriminator=discriminator,
        average=jax.tree.map(jnp.copy, generator.variables) if objective.average_decay else None,
        is_finite=jnp.ones((), bool),
    )


def set_pretrained(variables: Mapping[str, Any], pretrained: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the variables of a generator with pretrained values in place of initial ones.

    Args:
        variables: {"params", "batch_stats"} of the generator.
        pretrained: part of this tree; a table may have fewer rows than the generator's.
    """
    return _merge(variables, pretrained)


def _merge(tree: Any, part: Any) -> Any:
    if not isinstance(part, Mapping):
        # The table of Seq2Seq has more rows, the marks of a sentence, which keep their random values.
        return tree.at[: len(part)].set(jnp.asarray(part, jnp.float32))
    return {**tree, **{name: _merge(tree[name], value) for name, value in part.items()}}


def _network(variables: Mapping[str, Any], optimizer: optax.GradientTransformation) -> Network:
    params = variables["params"]
    return Network(params=params, batch_stats=variables.get("batch_stats", {}), opt_state=optimizer.init(params))


def _weights(method: str, weights: Config, names: tuple[str, ...]) -> tuple[tuple[str, float], ...]:
    if odd := sorted(set(weights) ^ set(names)):
        raise UserError(
            f"config.loss.{method}.weights and the terms of the objective differ in {', '.join(odd)}: give a weight to "
            f"{', '.join(names)}"
        )
    return tuple((name, float(weights[name])) for name in names)


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
