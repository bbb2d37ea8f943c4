"""One mesh axis, "data": the batch is split over it, the state is replicated. No other file names a mesh.

BatchNorm statistics and the candidates of the contrastive term are those of the global batch, so that any
number of devices gives the numbers of one.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import AxisType, Mesh, NamedSharding, PartitionSpec

from ha2g_jax.errors import UserError
from ha2g_jax.train.state import TrainState
from ha2g_jax.train.step import Metrics, train_step, validation_step
from ha2g_jax.train.task import Task

AXIS = "data"


def data_mesh(devices: Sequence[Any] | None = None) -> Mesh:
    """The mesh of `devices` (of `jax.devices()`), by default all devices of all hosts."""
    devices = jax.devices() if devices is None else devices
    # Auto axes: the compiler places collectives, so that a mean over the batch is a global mean.
    return jax.make_mesh((len(devices),), (AXIS,), axis_types=(AxisType.Auto,), devices=devices)


def replicate(mesh: Mesh, tree: Any) -> Any:
    """A copy of `tree` whole on every device; `compile_step` may give it up, the original stays valid."""
    return jax.device_put(jax.tree.map(jnp.copy, tree), NamedSharding(mesh, PartitionSpec()))


def shard_batch(mesh: Mesh, batch: dict[str, np.ndarray]) -> dict[str, jax.Array]:
    """The global batch, split over the devices, of which each host brings an equal part.

    Args:
        mesh: from `data_mesh`.
        batch: this host's examples, each array with the batch axis first.

    Raises:
        UserError: the host's part does not split evenly over its devices.
    """
    size = next(iter(batch.values())).shape[0]
    num_devices = mesh.local_mesh.size
    if size % num_devices:
        raise UserError(
            f"a batch of {size} does not split over {num_devices} devices: "
            f"set --config.train.batch_size to a multiple of {num_devices * jax.process_count()}"
        )
    sharding = NamedSharding(mesh, PartitionSpec(AXIS))
    return {name: jax.make_array_from_process_local_data(sharding, array) for name, array in batch.items()}


def compile_step(task: Task, mesh: Mesh) -> Callable[..., tuple[TrainState, Metrics]]:
    """`train_step` as (state, batch, key) -> (state, metrics), compiled; the state passed in is given up."""
    whole, split = NamedSharding(mesh, PartitionSpec()), NamedSharding(mesh, PartitionSpec(AXIS))
    return jax.jit(
        functools.partial(train_step, task),
        in_shardings=(whole, split, whole),
        out_shardings=whole,
        donate_argnums=0,
    )


def compile_validation_step(task: Task, mesh: Mesh) -> Callable[..., Metrics]:
    """`validation_step` as (state, batch, key) -> metrics, compiled."""
    whole, split = NamedSharding(mesh, PartitionSpec()), NamedSharding(mesh, PartitionSpec(AXIS))
    return jax.jit(functools.partial(validation_step, task), in_shardings=(whole, split, whole), out_shardings=whole)
