"""The objective of a training run: weights, optimisers, warm-up and accumulation, and the state that it starts from.

This module alone reads `config.loss` and those settings of `config.train` that define the update. The same settings
give the same optimisers, so that objectives built from them are equal static arguments of `jax.jit`.
"""

import dataclasses
import functools
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import optax

from ha2g_jax.checkpoint.state import Network, TrainState
from ha2g_jax.config.settings import Config
from ha2g_jax.errors import UserError
from ha2g_jax.layers.cpu.onednn.library import is_available
from ha2g_jax.methods import build, method_of
from ha2g_jax.methods.method import Compute, Spec, example_batch
from ha2g_jax.skeleton import Skeleton

# Settings of `config.loss.<method>` that every method has or may have; the others are the method's own.
_COMMON_LOSS_SETTINGS = ("weights", "gan")


@dataclasses.dataclass(frozen=True)
class Objective:
    """Everything about training that does not change from step to step; equal objectives are equal static arguments.

    Attributes:
        spec: networks and sizes.
        weights: weight of each term of the loss, `Method.Terms`.
        settings: settings of the terms, as `Method.terms` takes them.
        gan: kind of the adversarial loss; "" for a method without a discriminator.
        optimizer: Adam of either network, after clipping of the gradient's norm, without the learning rate.
        generator_rate, discriminator_rate: learning rate as a function of the step of the run, not of the updates: the
            discriminator is first updated after the warm-up, but its rate falls together with that of the generator.
        warmup_steps: steps before the GAN term is used (D9); 0 from `build_objective`, which knows no epochs.
        average_decay: largest decay of the running average of the generator in a step; 0 for no average.
        compute: precision of the activations, number of parts of a batch, and whether oneDNN is used.
    """

    spec: Spec
    weights: Any
    settings: Any
    gan: str
    optimizer: optax.GradientTransformation
    generator_rate: optax.Schedule
    discriminator_rate: optax.Schedule
    warmup_steps: int
    average_decay: float
    compute: Compute


def build_objective(
    config: Config,
    skeleton: Skeleton,
    vocabulary_size: int,
    num_speakers: int,
    *,
    onednn: bool | None = None,
) -> Objective:
    """Build the networks of a config and the objective that trains them.

    Args:
        config: settings, with the fields of `ha2g_jax.config.settings.paper`.
        skeleton, vocabulary_size, num_speakers: see `ha2g_jax.methods.build`.
        onednn: whether oneDNN computes convolutions and GRUs; None for yes where it is available.

    Raises:
        UserError: a setting that is not possible, or that the method cannot use.
    """
    train = config.train
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
    loss = config.loss[config.method]
    own = {name: value for name, value in loss.items() if name not in _COMMON_LOSS_SETTINGS}
    own |= {name: tuple(value) for name, value in own.items() if isinstance(value, list)}  # hashable
    return Objective(
        spec=spec,
        weights=method.Terms(**{name: float(weight) for name, weight in loss.weights.items()}),
        settings=method.LossSettings(**own),
        gan=loss.get("gan", ""),
        optimizer=adam(tuple(train.betas), train.clip_norm),
        generator_rate=learning_rate(train.schedule, train.learning_rate, train.steps),
        discriminator_rate=learning_rate(train.schedule, train.discriminator_learning_rate, train.steps),
        warmup_steps=0,
        average_decay=train.ema,
        compute=Compute(jnp.dtype(train.dtype), train.accumulate, is_available() if onednn is None else onednn),
    )


@functools.cache
def learning_rate(schedule: str, start: float, num_steps: int) -> optax.Schedule:
    """Return the learning rate as a function of the step: "constant", or "cosine", which falls to 0 at the last."""
    return optax.cosine_decay_schedule(start, num_steps) if schedule == "cosine" else optax.constant_schedule(start)


@functools.cache
def adam(betas: tuple[float, float], clip_norm: float = 0.0) -> optax.GradientTransformation:
    """Return Adam with learning rate 1.

    Gradients whose norm is larger than `clip_norm` are scaled down to it; 0 is no limit.
    """
    return optax.chain(
        optax.clip_by_global_norm(clip_norm) if clip_norm else optax.identity(),
        optax.scale_by_adam(b1=betas[0], b2=betas[1]),
        optax.scale(-1.0),
    )


@functools.partial(jax.jit, static_argnums=0)
def init_state(objective: Objective, key: jax.Array, pretrained: Mapping[str, Any] | None = None) -> TrainState:
    """Return the state before the first step: networks, their optimisers and the average.

    The values of `pretrained`, a part of the tree {"params", "batch_stats"} of the generator, replace the random ones.
    """
    spec = objective.spec
    generator_key, discriminator_key = jax.random.split(key)
    arguments = method_of(spec).init_arguments(spec, example_batch(spec))
    variables = spec.generator.init(generator_key, *arguments, train=False)
    generator = _network(merge(variables, pretrained or {}), objective.optimizer)
    discriminator = None
    if spec.discriminator is not None:
        poses = jnp.zeros((1, spec.num_frames, spec.skeleton.pose_dim), jnp.float32)
        variables = spec.discriminator.init(discriminator_key, poses, train=False)
        discriminator = _network(variables, objective.optimizer)
    return TrainState(
        step=jnp.zeros((), jnp.int32),
        generator=generator,
        discriminator=discriminator,
        average=jax.tree.map(jnp.copy, generator.variables) if objective.average_decay else None,
        is_finite=jnp.ones((), bool),
    )


def merge(tree: Any, part: Any) -> Any:
    """Return a tree of variables with the values of a part of it; a table of the part may have fewer rows."""
    if not isinstance(part, Mapping):
        # The table of Seq2Seq has more rows, for the start and end of a sentence, which keep their random values.
        return tree.at[: len(part)].set(jnp.asarray(part, jnp.float32))
    return {**tree, **{name: merge(tree[name], value) for name, value in part.items()}}


def _network(variables: Mapping[str, Any], optimizer: optax.GradientTransformation) -> Network:
    params = variables["params"]
    return Network(params=params, batch_stats=variables.get("batch_stats", {}), opt_state=optimizer.init(params))
