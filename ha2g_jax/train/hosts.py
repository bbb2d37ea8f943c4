"""Several processes train one model: who they are, how they find each other, and how they part.

Each process holds the devices it sees; JAX joins them. Process 0 is the first host: it runs the coordinator that the
others call, and it alone writes metrics.
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

# What srun tells a process about its place. A batch script and an interactive shell know much of it too, SLURM_NTASKS
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

_JOIN_SECONDS = 300  # for machines that start minutes apart
_PART_SECONDS = 30  # that a process which failed waits for the others to fail as well, before it ends them


def start(coordinator: str | None, num_processes: int | None, process_id: int | None) -> None:
    """Joins the processes of a run and returns when all are there; does nothing for a run of one process.

    What is None is looked for in JAX_COORDINATOR_ADDRESS, JAX_NUM_PROCESSES and JAX_PROCESS_ID, and the last then in
    the JOB_COMPLETION_INDEX of Kubernetes. Without any of them, a step that srun started is joined as Slurm has it.
    Must be called before JAX looks for devices.

    Args:
        coordinator: HOST:PORT at which all reach process 0; any port that is free there.
        num_processes: of all hosts; 1 keeps the processes of an srun apart.
        process_id: of this process, from 0.

    Raises:
        UserError: these do not fit together, or not all processes came in time.
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
    """Whether this process is the one that writes what a run has once."""
    return jax.process_index() == 0


def stop() -> None:
    """Waits for the other processes and parts from them, at the end of a run that went well.

    A process that ends by an error does not call it. When it exits it waits a little for the others, which may all
    have found the same mistake. If they go on, JAX ends them with an exit code other than 0: they need its part.
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
            f"a run of several processes needs --coordinator=HOST:PORT, --num_processes=N and --process_id=I: "
            f"add --{' and --'.join(missing)}"
        )
    if not re.fullmatch(r".+:\d+", str(coordinator)):
        raise UserError(f"the coordinator is {coordinator!r}: set --coordinator=HOST:PORT, such as node1:8476")
    if not 0 <= int(process_id or 0) < int(num_processes or 0):
        raise UserError(
            f"process_id is {process_id} of {num_processes} processes: "
            "number them from 0, and set --num_processes to how many there are"
        )


def _slurm_devices() -> list[int] | None:
    """For JAX: [] takes all GPUs that this process of an srun sees, None the one of its number on the node.

    The second, JAX's default, is right for one process a GPU, each of which sees all of them. It would leave GPUs of
    a node unused that has one process, and miss the only GPU of a process that srun bound to it.
    """
    if "JAX_LOCAL_DEVICE_IDS" in os.environ:
        return None
    is_alone = _number("SLURM_STEP_NUM_TASKS") == _number("SLURM_STEP_NUM_NODES")
    is_bound = bool(re.fullmatch(r"[^,]+", os.environ.get("CUDA_VISIBLE_DEVICES", "")))
    return [] if is_alone or is_bound else None


def _join(address: str, **settings: Any) -> None:
    """`jax.distributed.initialize`, in a thread: where it waits in vain it would end the process without a word."""
    # Its notice of a SIGTERM would take the place of Python's handling of it until the run sets its own.
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
            f"after {_JOIN_SECONDS} s not all processes of the run have joined at {address}: see that "
            "all were started with one --coordinator and --num_processes, and that they reach that address"
        )
    if errors and isinstance(errors[0], jax.errors.JaxRuntimeError):
        reason = " ".join(str(errors[0]).split())
        raise UserError(f"cannot join the run at {address} ({reason}): see that its port is free") from errors[0]
    if errors:
        raise errors[0]
    atexit.register(_leave)
    # Connects the devices now that all are here: on CPUs the first collective fails where one process comes to it
    # 30 s after another, as it may by then, with something else to compile or to read.
    multihost_utils.sync_global_devices("start of the run")


def _leave() -> None:
    """At the exit of a process that did not come to `stop`: parts from the others, or exits with 1 without them."""
    if jax.distributed.is_initialized():
        with pathlib.Path(os.devnull).open("w") as nowhere:
            # A thread that needs no Python, which starts none at its exit. JAX would abort this process too.
            faulthandler.dump_traceback_later(_PART_SECONDS, exit=True, file=nowhere)
            jax.distributed.shutdown()
            faulthandler.cancel_dump_traceback_later()
