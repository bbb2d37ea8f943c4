"""Adam with the settings of the config, on the learning rate schedule of the run.

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
    """Return the learning rate as a function of the step.

    Args:
        schedule: "constant" or "cosine", which falls from `start` to 0 at the last step.
        start: learning rate at step 0.
        num_steps: number of steps of the run.
    """
    return optax.cosine_decay_schedule(start, num_steps) if schedule == "cosine" else optax.constant_schedule(start)


@functools.cache
def adam(
    rate: optax.Schedule, betas: tuple[float, float], clip_norm: float = 0.0
) -> optax.GradientTransformationExtraArgs:
    """Return Adam, whose `update` takes `step=`, the step of the run.

    The optimiser's own count of updates is not used for the schedule, because the discriminator is first updated after
    the warm-up while its learning rate falls together with that of the generator.

    Args:
        rate: learning rate at a step.
        betas: decay rates of the first and second moments.
        clip_norm: largest norm of the gradient; larger gradients are scaled down to it; 0 for no limit.
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
