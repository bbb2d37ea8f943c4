"""What training carries from step to step: two networks, each with its parameters, statistics and optimiser."""

from typing import Any

import flax.struct
import jax
import jax.numpy as jnp
import optax

from ha2g_jax.train.task import Task, example_batch, set_word_vectors


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
    """Attributes:
    step: () int32, the number of steps taken.
    generator, discriminator: the two networks of Eq. 6.
    """

    step: jax.Array
    generator: Network
    discriminator: Network


def init_state(task: Task, key: jax.Array) -> TrainState:
    """Fresh networks; word vectors of the task, where it has them, are put in place of random ones."""

    @jax.jit
    def init(key):
        generator_key, discriminator_key = jax.random.split(key)
        batch = example_batch(task)
        generator = task.generator.init(
            generator_key,
            batch["mel"],
            batch["words"],
            batch[task.identity_input],
            jnp.zeros((1, task.num_seed_frames, task.skeleton.pose_dim)),
            train=False,
        )
        poses = jnp.zeros((1, task.num_frames, task.skeleton.pose_dim))
        return generator, task.discriminator.init(discriminator_key, poses, train=False)

    generator, discriminator = init(key)
    return TrainState(
        step=jnp.zeros((), jnp.int32),
        generator=_network(set_word_vectors(task, generator), task.generator_optimizer),
        discriminator=_network(discriminator, task.discriminator_optimizer),
    )


def _network(variables: dict[str, Any], optimizer: optax.GradientTransformation) -> Network:
    params = variables["params"]
    return Network(params=params, batch_stats=variables.get("batch_stats", {}), opt_state=optimizer.init(params))
