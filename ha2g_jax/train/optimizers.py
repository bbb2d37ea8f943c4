"""Adam as the config describes it, on the schedule of the run.

The same settings give the same object, so that objectives built from them are equal static arguments of `jax.jit`.
"""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import optax

SCHEDULES = ("constant", "cosine")


@functools.cache
def learning_rate(schedule: str, start: float, num_steps: int) -> optax.Schedule:
    """Return the learning rate at each step: always `start`, or on a cosine from `start` to 0 at the last step."""
    return optax.cosine_decay_schedule(start, num_steps) if schedule == "cosine" else optax.constant_schedule(start)


@functools.cache
def adam(
    rate: optax.Schedule, betas: tuple[float, float], clip_norm: float = 0.0
) -> optax.GradientTransformationExtraArgs:
    """Return Adam behind a limit of the gradient's norm, where `clip_norm` is not 0; `update` takes `step=` of the run.

    An optimiser's own count of updates would not do for the schedule: the discriminator waits for the end of the
    warm-up, but its rate falls with the generator's.
    """

    def descend(updates: Any, state: Any, params: Any = None, **extra: Any) -> tuple[Any, Any]:
        del params
        factor = -jnp.asarray(rate(extra["step"]))
        return jax.tree.map(lambda update: factor * update, updates), state

    return optax.chain(
        optax.clip_by_global_norm(clip_norm) if clip_norm else optax.identity(),
        optax.scale_by_adam(b1=betas[0], b2=betas[1]),
        optax.GradientTransformationExtraArgs(lambda params: optax.EmptyState(), descend),
    )
