"""One mesh axis, "data": the batch is split over it, and the state is replicated. No other module creates a mesh.

BatchNorm statistics and the candidates of the contrastive term are those of the global batch, so that the results do
not depend on the number of devices and hosts.
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
from ha2g_jax.train.step import Metrics, settle_average, train_step, validation_step

AXIS = "data"


def data_mesh(devices: Sequence[Any] | None = None) -> Mesh:
    """Return a mesh of devices, by default of all devices of all hosts.

    Raises:
        UserError: the hosts do not have the same number of devices, so that their parts of a batch would differ.
    """
    devices = jax.devices() if devices is None else devices
    counts = collections.Counter(device.process_index for device in devices)
    numbers = [counts[process] for process in range(jax.process_count())]
    if len(set(numbers)) > 1:
        raise UserError(
            f"the hosts have {', '.join(map(str, numbers))} devices, expected the same number on each: "
            "set --config.train.devices=0 and give every process the same number of devices"
        )
    # Auto axes: the compiler places collectives, so that a mean over the batch is a global mean.
    return jax.make_mesh((len(devices),), (AXIS,), axis_types=(AxisType.Auto,), devices=devices)


def whole(mesh: Mesh, shapes: Any) -> Any:
    """Return a tree of `jax.ShapeDtypeStruct` with the sharding of arrays that are replicated on all devices."""
    sharding = NamedSharding(mesh, PartitionSpec())
    return jax.tree.map(lambda x: x.update(sharding=sharding), shapes)


def replicate(mesh: Mesh, tree: Any) -> Any:
    """Return a copy of a tree that is replicated on every device; the step may donate it, the original stays valid.

    Each host holds all arrays in full, equal on all hosts.
    """
    sharding, devices = NamedSharding(mesh, PartitionSpec()), mesh.local_mesh.devices.tolist()

    def copy(x: Any) -> jax.Array:
        # One copy for each device: on a CPU a device may keep using the memory that it was given.
        parts = [jax.device_put(np.array(x), device) for device in devices]
        return jax.make_array_from_single_device_arrays(parts[0].shape, sharding, parts)

    return jax.tree.map(copy, tree)


def check_batch_size(size: int, num_devices: int) -> None:
    """Check that a batch splits evenly over the devices.

    Raises:
        UserError: it does not.
    """
    if size % num_devices:
        raise UserError(
            f"a batch of {size} does not split over {num_devices} devices: "
            f"set --config.train.batch_size to a multiple of {num_devices}"
        )


def shard_batch(mesh: Mesh, batch: dict[str, np.ndarray]) -> dict[str, jax.Array]:
    """Return the global batch, split over the devices; each host provides an equal part, with the batch axis first."""
    sharding = NamedSharding(mesh, PartitionSpec(AXIS))
    arrays = {name: jax.make_array_from_process_local_data(sharding, array) for name, array in batch.items()}
    if jax.default_backend() == "cpu":
        # JAX runs a program in the calling thread, as `memory.keep_memory` needs, only if its inputs are ready.
        jax.block_until_ready(arrays)
    return arrays


def compile_step(objective: Objective, mesh: Mesh) -> Callable[..., tuple[TrainState, Metrics]]:
    """Compile `train_step` as a function (state, batch, key, stop=False) -> (state, metrics); the state is donated.

    `stop` says whether this host was asked to end the run. metrics["stop"] is () bool and the same on all hosts:
    whether any host was asked at this step. It is computed with the step, so that hosts agree without waiting for each
    other.
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


def compile_settling(objective: Objective, mesh: Mesh) -> Callable[..., TrainState]:
    """Compile `settle_average` as a function (state, batch, key) -> state; the state is donated."""
    copied, split = NamedSharding(mesh, PartitionSpec()), NamedSharding(mesh, PartitionSpec(AXIS))
    settle = functools.partial(settle_average, objective)
    return jax.jit(settle, in_shardings=(copied, split, copied), out_shardings=copied, donate_argnums=0)


def compile_validation_step(objective: Objective, mesh: Mesh) -> Callable[..., Metrics]:
    """Compile `validation_step` as a function (state, batch, key) -> metrics."""
    copied, split = NamedSharding(mesh, PartitionSpec()), NamedSharding(mesh, PartitionSpec(AXIS))
    return jax.jit(
        functools.partial(validation_step, objective), in_shardings=(copied, split, copied), out_shardings=copied
    )
