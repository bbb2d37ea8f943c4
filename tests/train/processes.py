"""Start the processes of a run for the tests; also the script that these processes run.

`python processes.py COORDINATOR COUNT ID START.pickle END.pickle` trains on its rows of the batches.
"""

import concurrent.futures
import dataclasses
import os
import pathlib
import pickle
import socket
import subprocess
import sys
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np
import optax

from ha2g_jax.checkpoint.state import TrainState
from ha2g_jax.config import presets
from ha2g_jax.skeleton import load_skeleton
from ha2g_jax.train import hosts, sharding
from ha2g_jax.train.objective import Objective, build_objective

STOP_AT = 2  # the step at which the last process asks to end

_TIMEOUT = 600  # seconds; compiling takes most of it on a busy machine without a cache


def sgd_objective(method: str) -> Objective:
    """Return HA2G of the last level, or Trimodal, which compiles in half the time, under plain gradient descent."""
    config = presets.make("ted_gesture", "debug", method)
    config.model.identity.kind = "speakers"
    config.model.inferer.levels = (3,)
    config.model.inferer.layers = 2
    config.model.inferer.dropout = 0.3
    objective = build_objective(config, load_skeleton("ted_gesture"), 11, 5)
    rates = {
        "generator_rate": optax.constant_schedule(1e-4),
        "discriminator_rate": optax.constant_schedule(1e-2),
    }
    return dataclasses.replace(objective, warmup_steps=2, optimizer=optax.scale(-1.0), **rates)


def train(
    objective: Objective,
    state: TrainState,
    batches: Sequence[dict[str, np.ndarray]],
    devices: list[Any],
    stop_at: int = -1,
) -> tuple[TrainState, list[dict[str, np.ndarray]]]:
    """Return the state after a step on the rows of this process in each batch, and the metrics of the steps."""
    mesh = sharding.data_mesh(devices)
    step, state, history = sharding.compile_step(objective, mesh), sharding.replicate(mesh, state), []
    for number, batch in enumerate(batches):
        state, metrics = step(state, sharding.shard_batch(mesh, batch), jax.random.key(1), number == stop_at)
        history.append(metrics)
    return jax.device_get((state, history))


def train_in_processes(
    folder: pathlib.Path, state: TrainState, batches: Sequence[dict[str, np.ndarray]], count: int, devices: int
) -> tuple[list[np.ndarray], list[bool]]:
    """Train Trimodal in `count` processes with `devices` each.

    Returns:
        The leaves of the state after the steps, and which steps stop.
    """
    start, end = folder / "start.pickle", folder / "end.pickle"
    start.write_bytes(pickle.dumps((state, batches)))
    coordinator = free_address()
    commands = [
        [sys.executable, __file__, coordinator, str(count), str(process), str(start), str(end)]
        for process in range(count)
    ]
    for code, output in finish(commands, devices):
        assert code == 0, output
    return pickle.loads(end.read_bytes())


def free_address() -> str:
    """Return a free HOST:PORT of this machine."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        return f"127.0.0.1:{server.getsockname()[1]}"


def finish(
    commands: Sequence[Sequence[str]], devices: int = 1, variables: Sequence[dict[str, str]] = ()
) -> list[tuple[int | None, str]]:
    """Run commands at the same time, each on some virtual devices and with environment variables of its own.

    Returns:
        The exit code (None if it did not end in time) and the output of each.
    """
    flags = f"{os.environ['XLA_FLAGS']} --xla_force_host_platform_device_count={devices}"
    output: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}

    def run(command: Sequence[str], own: dict[str, str]) -> tuple[int | None, str]:
        environment = {**os.environ, "XLA_FLAGS": flags, **own}
        try:
            done = subprocess.run(command, env=environment, timeout=_TIMEOUT, check=False, **output)
        except subprocess.TimeoutExpired as error:
            return None, (error.stdout or b"").decode()
        return done.returncode, done.stdout.decode()

    with concurrent.futures.ThreadPoolExecutor(len(commands)) as pool:
        return list(pool.map(run, commands, variables or [{}] * len(commands)))


def _main(coordinator: str, count: str, process: str, start: str, end: str) -> None:
    hosts.start(coordinator, int(count), int(process))
    state, batches = pickle.loads(pathlib.Path(start).read_bytes())
    batches = jax.tree.map(lambda array: np.split(array, int(count))[int(process)], batches)
    is_last = int(process) == int(count) - 1
    state, history = train(sgd_objective("trimodal"), state, batches, jax.devices(), STOP_AT if is_last else -1)
    if hosts.is_first():
        stops = [bool(metrics["stop"]) for metrics in history]
        pathlib.Path(end).write_bytes(pickle.dumps((jax.tree.leaves(state), stops)))
    hosts.stop()


if __name__ == "__main__":
    _main(*sys.argv[1:])
