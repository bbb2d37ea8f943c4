"""One mesh axis, "data": the batch is split over it, the state is replicated. No other file names a mesh.

BatchNorm statistics and the candidates of the contrastive term are those of the global batch, so that any
number of devices, of any number of hosts, gives the numbers of one.
"""

import collections
import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import AxisType, Mesh, NamedSharding, PartitionSpec

from ha2g_jax.checkpoint.state import TrainState
from ha2g_jax.errors import UserError
from ha2g_jax.train.objective import Objective
from ha2g_jax.train.step import Metrics, train_step, validation_step

AXIS = "data"


def data_mesh(devices: Sequence[Any] | None = None) -> Mesh:
    """The mesh of `devices` (of `jax.devices()`), by default all devices of all hosts.

    Raises:
        UserError: the hosts do not have equally many of them, so that their parts of a batch would differ.
    """
    devices = jax.devices() if devices is None else devices
    counts = collections.Counter(device.process_index for device in devices)
    numbers = [counts[process] for process in range(jax.process_count())]
    if len(set(numbers)) > 1:
        raise UserError(
            f"the hosts bring {', '.join(map(str, numbers))} devices to the run, which must be equally many: "
            "set --config.train.devices=0 and give every process the same devices"
        )
    # Auto axes: the compiler places collectives, so that a mean over the batch is a global mean.
    return jax.make_mesh((len(devices),), (AXIS,), axis_types=(AxisType.Auto,), devices=devices)


def whole(mesh: Mesh, shapes: Any) -> Any:
    """`shapes`, a tree of `jax.ShapeDtypeStruct`, as those of arrays that are whole on every device of the mesh."""
    sharding = NamedSharding(mesh, PartitionSpec())
    return jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype, sharding=sharding), shapes)


def replicate(mesh: Mesh, tree: Any) -> Any:
    """A copy of `tree` whole on every device; `compile_step` may give it up, the original stays valid.

    Args:
        mesh: from `data_mesh`.
        tree: of arrays that are whole on this host, and equal on all hosts.
    """
    sharding, devices = NamedSharding(mesh, PartitionSpec()), mesh.local_mesh.devices.tolist()

    def copy(x: Any) -> jax.Array:
        # One copy for each device: on a CPU a device may go on using the memory that it was handed.
        parts = [jax.device_put(np.array(x), device) for device in devices]
        return jax.make_array_from_single_device_arrays(parts[0].shape, sharding, parts)

    return jax.tree.map(copy, tree)


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
            f"set --config.train.batch_size to a multiple of {mesh.size}"
        )
    sharding = NamedSharding(mesh, PartitionSpec(AXIS))
    return {name: jax.make_array_from_process_local_data(sharding, array) for name, array in batch.items()}


def compile_step(objective: Objective, mesh: Mesh) -> Callable[..., tuple[TrainState, Metrics]]:
    """`train_step` as (state, batch, key, stop=False) -> (state, metrics), compiled; the state passed in is given up.

    `stop` is this host's wish to end the run. metrics["stop"] is () bool, on all hosts the same: whether any of them
    had it at this step. It is computed with the step, so that hosts agree without waiting for each other.
    """
    copied, split = NamedSharding(mesh, PartitionSpec()), NamedSharding(mesh, PartitionSpec(AXIS))

    def step(state, batch, key, stops):
        state, metrics = train_step(objective, state, batch, key)
        return state, metrics | {"stop": jnp.any(stops)}

    compiled = jax.jit(step, in_shardings=(copied, split, copied, split), out_shardings=copied, donate_argnums=0)
    go_on, end = (
        jax.make_array_from_process_local_data(split, np.full(mesh.local_mesh.size, wish)) for wish in (False, True)
    )
    return lambda state, batch, key, stop=False: compiled(state, batch, key, end if stop else go_on)


def compile_validation_step(objective: Objective, mesh: Mesh) -> Callable[..., Metrics]:
    """`validation_step` as (state, batch, key) -> metrics, compiled."""
    copied, split = NamedSharding(mesh, PartitionSpec()), NamedSharding(mesh, PartitionSpec(AXIS))
    return jax.jit(
        functools.partial(validation_step, objective), in_shardings=(copied, split, copied), out_shardings=copied
    )
