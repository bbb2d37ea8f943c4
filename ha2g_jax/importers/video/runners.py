"""Parallel calls on this machine or on a Ray cluster, which are repeated when a worker dies."""

import collections
import contextlib
import logging
import multiprocessing
import os
import pathlib
import pickle
import signal
import traceback
from collections.abc import Callable, Generator, Sequence
from multiprocessing import connection
from multiprocessing.context import SpawnContext, SpawnProcess
from typing import Any, NamedTuple, TypeVar

from ha2g_jax.errors import UserError, require

Item = TypeVar("Item")
Result = TypeVar("Result")

_TRIES = 2
_RAY_RETRIES = 3  # more than on one machine, because a cluster also loses whole nodes
_EXIT_SECONDS = 10


class WorkerDied(Exception):
    """Error for an item whose process died, and died again when it was repeated; the message has the cause."""


class _Worker(NamedTuple):
    process: SpawnProcess
    item: int
    tries: int


def local(
    function: Callable[[Item], Result], items: Sequence[Item], workers: int | None = None
) -> Generator[tuple[Item, Result | Exception], None, None]:
    """Call a function on each item, each time in a new process.

    When a process dies (a crash in a library, no memory left), its item is tried once more. Processes that a worker
    has started end with it, and all workers end with this process, even if it is killed.

    Args:
        function: function that is importable by name; runs with one thread of OpenMP, as on a cluster.
        items: items that can be pickled.
        workers: number of simultaneous processes; one per core by default.

    Yields:
        (item, result) in the order in which they finish; the result may be the function's exception or `WorkerDied`.
    """
    # spawn: the workers must not inherit state of this process or of an accelerator library.
    context = multiprocessing.get_context("spawn")
    workers = workers or os.cpu_count() or 1
    waiting = collections.deque((item, 1) for item in range(len(items)))
    running: dict[connection.Connection, _Worker] = {}
    try:
        while waiting or running:
            while waiting and len(running) < workers:
                item, tries = waiting.popleft()
                pipe, process = _start(context, function, items[item])
                running[pipe] = _Worker(process, item, tries)
            for pipe in connection.wait([*running]):
                assert isinstance(pipe, connection.Connection)
                worker = running[pipe]
                outcome = _receive(pipe, worker.process)
                _end(pipe, worker.process)
                del running[pipe]
                if outcome is not None:
                    yield items[worker.item], outcome[0]
                elif worker.tries < _TRIES:
                    waiting.append((worker.item, worker.tries + 1))
                else:
                    reason = _cause(worker.process.exitcode)
                    yield items[worker.item], WorkerDied(f"its process died {_TRIES} times, the last time {reason}")
    finally:
        for pipe, worker in running.items():
            _end(pipe, worker.process)


def ray(
    function: Callable[[Item], Result],
    items: Sequence[Item],
    workers: int | None = None,
    address: str | None = None,
) -> Generator[tuple[Item, Result | Exception], None, None]:
    """Call a function on each item as a task of one CPU on a Ray cluster; tasks are repeated if a node or worker dies.

    Every node must have this package, and find the files of the items under the same paths.

    Args:
        function: function that is importable by name.
        items: items that can be pickled.
        workers: number of simultaneous tasks; the number of CPUs of the cluster by default.
        address: address of the cluster; None for the one that $RAY_ADDRESS names or that runs on this machine, else a
            new one for this call.

    Yields:
        (item, result) as `local` does.

    Raises:
        UserError: Ray is not installed, or there is no cluster at the address.
    """
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    library = require("ray", "ray", by="--runner ray")
    is_mine = not library.is_initialized()
    if is_mine:
        try:
            library.init(address=address, log_to_driver=False, logging_level=logging.ERROR)
        except (ConnectionError, ValueError, RuntimeError) as error:
            raise UserError(f"no Ray cluster at {address or os.environ.get('RAY_ADDRESS')} ({_line(error)})") from error
    task = library.remote(num_cpus=1, max_retries=_RAY_RETRIES)(_call_apart)
    waiting = collections.deque(items)
    running: dict[Any, Item] = {}
    try:
        while waiting or running:
            while waiting and len(running) < (workers or len(items)):
                item = waiting.popleft()
                running[task.remote(function, item)] = item
            done, _ = library.wait([*running])
            for reference in done:
                item = running.pop(reference)
                try:
                    outcome = library.get(reference)
                except library.exceptions.RayError as error:
                    outcome = WorkerDied(f"its worker on the cluster died {_RAY_RETRIES + 1} times ({_line(error)})")
                del reference  # the cluster keeps a result in memory while its reference exists
                yield item, outcome
    finally:
        for reference in running:
            library.cancel(reference, force=True)
        if is_mine:
            library.shutdown()


def _call_apart(function: Callable[[Any], Any], item: Any) -> Any:
    """Call in a new process, so that a crash does not end the Ray worker, and a killed worker leaves no process."""
    [(_, outcome)] = local(function, [item], 1)
    return outcome


def _start(
    context: SpawnContext, function: Callable[[Any], Any], item: Any
) -> tuple[connection.Connection, SpawnProcess]:
    ours, theirs = context.Pipe(duplex=False)
    process = context.Process(target=_work, args=(theirs, pickle.dumps((function, item))), daemon=True)
    process.start()
    theirs.close()  # so that the pipe ends when the worker does
    return ours, process


def _work(pipe: connection.Connection, call: bytes) -> None:
    """Run one call in a worker, which leads a process group so that Ctrl-C reaches only the parent."""
    os.setsid()
    _guard()
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # before the function's libraries are imported
    try:
        function, item = pickle.loads(call)
        pipe.send(function(item))
    except UserError as error:
        pipe.send(error)
    except (Exception, SystemExit) as error:  # the parent reports it and goes on with other items
        pipe.send(RuntimeError(_line(error)))


def _guard() -> None:
    """Fork a process that kills the group, including all that the worker has started, when the worker or its parent
    ends.

    The worker cannot do this itself, because it may be killed: a Ray worker that ends kills its children.
    """
    parent = multiprocessing.parent_process()
    assert parent is not None
    ours, _ = os.pipe()  # the other end is closed when the worker ends, for any reason
    if os.fork():
        os.close(ours)
        return
    for number in {int(path.name) for path in pathlib.Path("/dev/fd").iterdir()} - {0, 1, 2, ours, parent.sentinel}:
        with contextlib.suppress(OSError):  # the descriptor that listed the folder is closed already
            os.close(number)
    connection.wait([ours, parent.sentinel])
    os.killpg(0, signal.SIGKILL)


def _receive(pipe: connection.Connection, process: SpawnProcess) -> tuple[Any] | None:
    """Return the result that a worker has sent, None if it died before."""
    try:
        outcome = (pipe.recv(),)
    except (EOFError, OSError):
        return None
    process.join(_EXIT_SECONDS)
    return outcome


def _end(pipe: connection.Connection, process: SpawnProcess) -> None:
    """End a worker and all that it has started, unless it has succeeded."""
    if process.pid and process.exitcode != 0:  # a group exists until all its members have ended
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
        process.kill()
        process.join()
    pipe.close()


def _cause(exit_code: int | None) -> str:
    if exit_code is None or exit_code >= 0:
        return f"with exit code {exit_code}"
    name = signal.Signals(-exit_code).name
    return f"of {name}" + (", as when memory runs out" if -exit_code == signal.SIGKILL else "")


def _line(error: BaseException) -> str:
    """Format an exception as one line: type, message, and where it was raised."""
    frames = traceback.extract_tb(error.__traceback__)
    place = f" [{pathlib.Path(frames[-1].filename).name}:{frames[-1].lineno}]" if frames else ""
    return f"{type(error).__name__}: {' '.join(str(error).split())}{place}"
