"""What training carries from step to step: two networks, each with its parameters, statistics and optimiser."""

import functools
from collections.abc import Mapping
from typing import Any

import flax.struct
import jax
import jax.numpy as jnp
import optax

from ha2g_jax.methods.task import Task, example_batch, set_pretrained


class Network(flax.struct.PyTreeNode):
    """Parameters, BatchNorm running statistics and optimiser state of one network."""

    params: Any
    batch_stats: Any
    opt_state: Any

    @property
    def variables(self) -> dict[str, Any]:
        """What `module.apply` takes."""
        return {"params": self.params, "batch_stats": self.batch_stats}


class TrainState(flax.struct.PyTreeNode):
    """The networks after `step` steps: those of Eq. 6, or a generator alone.

    Attributes:
        step: () int32.
        generator, discriminator: as they are trained; None for a method without a discriminator.
        average: {"params", "batch_stats"} of the generator, their running mean over the steps; None where the task
            keeps none.
        is_finite: () bool, whether the losses and gradient norms of all steps were finite. Once one was not, no
            step changes anything: the state stays as it was before that step.
    """

    step: jax.Array
    generator: Network
    discriminator: Network | None
    average: Any
    is_finite: jax.Array

    @property
    def model(self) -> dict[str, Any]:
        """The generator's variables to evaluate and to ship: their average where there is one."""
        return self.generator.variables if self.average is None else self.average


@functools.partial(jax.jit, static_argnums=0)
def init_state(task: Task, key: jax.Array) -> TrainState:
    """Fresh networks; the task's pretrained parameters, where it has them, take the place of random ones."""
    generator_key, discriminator_key = jax.random.split(key)
    arguments = task.method.arguments(task, example_batch(task))
    generator = task.generator.init(generator_key, *arguments, train=False)
    network = _network(set_pretrained(task, generator), task.generator_optimizer)
    discriminator = None
    if task.discriminator is not None:
        poses = jnp.zeros((1, task.num_frames, task.skeleton.pose_dim))
        variables = task.discriminator.init(discriminator_key, poses, train=False)
        discriminator = _network(variables, task.discriminator_optimizer)
    return TrainState(
        step=jnp.zeros((), jnp.int32),
        generator=network,
        discriminator=discriminator,
        average=jax.tree.map(jnp.copy, network.variables) if task.average_decay else None,
        is_finite=jnp.ones((), bool),
    )


def _network(variables: Mapping[str, Any], optimizer: optax.GradientTransformation) -> Network:
    params = variables["params"]
    return Network(params=params, batch_stats=variables.get("batch_stats", {}), opt_state=optimizer.init(params))
