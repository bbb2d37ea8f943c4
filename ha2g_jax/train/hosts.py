"""Processes that train one model together: how they find each other, and how they end.

Each process uses the devices that it sees, and JAX joins the processes. Process 0 is the first host: it runs the
coordinator that the others connect to, and it alone writes metrics.
"""

import atexit
import faulthandler
import os
import pathlib
import re
import threading
from typing import Any

import jax
from jax.experimental import multihost_utils

from ha2g_jax.errors import UserError

# Variables that srun sets for a process. A batch script and an interactive shell have most of them too, SLURM_NTASKS
# included, but are one process: SLURM_STEP_NUM_TASKS is then 1 or absent.
_SLURM = (
    "SLURM_JOB_ID",
    "SLURM_STEP_NODELIST",
    "SLURM_STEP_NUM_NODES",
    "SLURM_STEP_NUM_TASKS",
    "SLURM_NTASKS",
    "SLURM_PROCID",
    "SLURM_LOCALID",
)

_JOIN_SECONDS = 300  # machines may start minutes apart
_PART_SECONDS = 30  # a failed process waits this long for the others to fail as well before it ends them


def start(coordinator: str | None, num_processes: int | None, process_id: int | None) -> None:
    """Join the processes of a run and return when all have joined; do nothing for a run of one process.

    Arguments that are None are read from the variables JAX_COORDINATOR_ADDRESS, JAX_NUM_PROCESSES and JAX_PROCESS_ID,
    and the process id then from JOB_COMPLETION_INDEX, which Kubernetes sets. If none of them is given, the tasks of a
    Slurm step started by srun are joined. This function must be called before JAX looks for devices.

    Args:
        coordinator: HOST:PORT at which all processes reach process 0; any port that is free there.
        num_processes: number of processes on all hosts; with 1 the tasks of an srun are not joined.
        process_id: number of this process, from 0.

    Raises:
        UserError: the arguments contradict each other, or not all processes joined in time.
    """
    coordinator = coordinator or os.environ.get("JAX_COORDINATOR_ADDRESS")
    num_processes = _number("JAX_NUM_PROCESSES") if num_processes is None else num_processes
    process_id = _number("JAX_PROCESS_ID") if process_id is None else process_id
    if (coordinator, num_processes, process_id) == (None, None, None):
        if all(name in os.environ for name in _SLURM) and (_number("SLURM_STEP_NUM_TASKS") or 1) > 1:
            nodes = os.environ["SLURM_STEP_NODELIST"]
            _join(f"the first node of {nodes}", cluster_detection_method="slurm", local_device_ids=_slurm_devices())
        return
    if num_processes == 1 and not process_id:
        return
    process_id = _number("JOB_COMPLETION_INDEX") if process_id is None else process_id
    _check(coordinator, num_processes, process_id)
    _join(
        str(coordinator),
        coordinator_address=coordinator,
        num_processes=num_processes,
        process_id=process_id,
        cluster_detection_method="deactivate",  # it would ask for another package in Kubernetes
    )


def is_first() -> bool:
    """Return whether this process is process 0, which writes the files that a run has once."""
    return jax.process_index() == 0


def stop() -> None:
    """Wait for the other processes and disconnect from them, at the end of a run without an error.

    A process that ends with an error does not call this function. When it exits, it waits a little for the others,
    which may all have failed with the same error. If they continue, JAX ends them with an exit code other than 0,
    because they need the part of the batch that this process holds.
    """
    if jax.distributed.is_initialized():
        multihost_utils.sync_global_devices("end of the run")
        jax.distributed.shutdown()


def _number(variable: str) -> int | None:
    value = os.environ.get(variable)
    if value is not None and not value.isdecimal():
        raise UserError(f"the environment has {variable}={value!r}, expected a number: correct or unset it")
    return None if value is None else int(value)


def _check(coordinator: str | None, num_processes: int | None, process_id: int | None) -> None:
    given = {"coordinator": coordinator, "num_processes": num_processes, "process_id": process_id}
    if missing := [name for name, value in given.items() if value is None]:
        raise UserError(
            "a run of several processes needs --coordinator=HOST:PORT, --num_processes=N and --process_id=I: "
            f"add --{' and --'.join(missing)}"
        )
    if not re.fullmatch(r".+:\d+", str(coordinator)):
        raise UserError(f"the coordinator is {coordinator!r}: set --coordinator=HOST:PORT, such as node1:8476")
    if not 0 <= int(process_id or 0) < int(num_processes or 0):
        raise UserError(
            f"process_id is {process_id} of {num_processes} processes: "
            "number them from 0, and set --num_processes to the number of processes"
        )


def _slurm_devices() -> list[int] | None:
    """Return `local_device_ids` for JAX: [] for all GPUs that this task of an srun sees, None for JAX's default.

    The default is the GPU with the number of the task on its node. This is right for one task per GPU where each task
    sees all GPUs. On a node with one task it would leave GPUs unused, and it would fail where srun bound a task to its
    only GPU.
    """
    if "JAX_LOCAL_DEVICE_IDS" in os.environ:
        return None
    is_alone = _number("SLURM_STEP_NUM_TASKS") == _number("SLURM_STEP_NUM_NODES")
    is_bound = bool(re.fullmatch(r"[^,]+", os.environ.get("CUDA_VISIBLE_DEVICES", "")))
    return [] if is_alone or is_bound else None


def _join(address: str, **settings: Any) -> None:
    """Call `jax.distributed.initialize` in a thread, because at its timeout it ends the process without a message."""
    # The preemption service would replace Python's handling of SIGTERM until the run installs its own.
    jax.config.update("jax_enable_preemption_service", False)
    errors: list[Exception] = []

    def initialize() -> None:
        try:
            jax.distributed.initialize(
                initialization_timeout=2 * _JOIN_SECONDS, shutdown_timeout_seconds=_PART_SECONDS + 5, **settings
            )
        except Exception as error:
            errors.append(error)

    thread = threading.Thread(target=initialize, daemon=True)
    thread.start()
    thread.join(_JOIN_SECONDS)
    if thread.is_alive():
        raise UserError(
            f"after {_JOIN_SECONDS} s not all processes of the run have joined at {address}: check that all were "
            "started with the same --coordinator and --num_processes, and that they reach that address"
        )
    if errors and isinstance(errors[0], jax.errors.JaxRuntimeError):
        reason = " ".join(str(errors[0]).split())
        raise UserError(f"cannot join the run at {address} ({reason}): check that the port is free") from errors[0]
    if errors:
        raise errors[0]
    atexit.register(_leave)
    if jax.default_backend() == "cpu":
        # Only process 0 finds its programs in the compilation cache, and on CPUs the collectives of a program from
        # there and of one that was just compiled may not match.
        jax.config.update("jax_enable_compilation_cache", False)
    # Connect the devices while all processes are here: on CPUs the first collective fails if one process reaches it
    # 30 s after another, which may happen later, when one has more to compile or to read.
    multihost_utils.sync_global_devices("start of the run")


def _leave() -> None:
    """Disconnect at the exit of a process that did not call `stop`; exit with 1 if the others do not answer."""
    if jax.distributed.is_initialized():
        with pathlib.Path(os.devnull).open("w") as nowhere:
            # This timer is a thread outside Python, which starts no threads at exit. JAX would abort this process too.
            faulthandler.dump_traceback_later(_PART_SECONDS, exit=True, file=nowhere)
            jax.distributed.shutdown()
            faulthandler.cancel_dump_traceback_later()
