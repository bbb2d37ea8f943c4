"""Parallel calls on this machine or on a Ray cluster, which are repeated when a worker dies."""

import collections
import contextlib
import logging
import multiprocessing
import os
import pathlib
import pickle
import signal
import tempfile
import threading
import traceback
from collections.abc import Callable, Generator, Sequence
from multiprocessing import connection
from multiprocessing.context import SpawnProcess
from typing import Any, NamedTuple, TypeVar

from ha2g_jax.errors import UserError, require
from ha2g_jax.stopping import signal_name

Item = TypeVar("Item")
Result = TypeVar("Result")

_TRIES = 2
_RAY_RETRIES = 3  # more than on one machine, because a cluster also loses whole nodes
_EXIT_SECONDS = 10


class WorkerDied(Exception):
    """Error for an item whose process died, and died again when it was repeated; the message has the cause."""


class _Worker(NamedTuple):
    process: SpawnProcess
    item: Any
    tries: int


def local(
    function: Callable[[Item], Result], items: Sequence[Item], workers: int | None = None
) -> Generator[tuple[Item, Result | Exception], None, None]:
    """Call a function that is importable by name on each item, each time in a new process with one OpenMP thread.

    When a process dies (a crash in a library, no memory left), its item is tried once more. All workers, and the
    processes that they have started, end with this process, even if it is killed; their temporary files are removed
    at the end, also those of a worker that died. There is a worker per core by default.

    Yields:
        (item, result) in the order in which they finish; the result may be the function's exception or `WorkerDied`.
    """
    # spawn: the workers must not inherit state of this process or of an accelerator library.
    context = multiprocessing.get_context("spawn")
    workers = workers or os.cpu_count() or 1
    waiting = collections.deque((item, 1) for item in items)
    running: dict[connection.Connection, _Worker] = {}
    folder = tempfile.TemporaryDirectory(prefix="ha2g-")
    try:
        while waiting or running:
            while waiting and len(running) < workers:
                item, tries = waiting.popleft()
                ours, theirs = context.Pipe(duplex=False)
                call = (theirs, pickle.dumps((function, item)), folder.name)
                process = context.Process(target=_work, args=call, daemon=True)
                process.start()
                theirs.close()  # so that the pipe ends when the worker does
                running[ours] = _Worker(process, item, tries)
            for pipe in connection.wait([*running]):
                assert isinstance(pipe, connection.Connection)
                worker = running[pipe]
                outcome: list[Any] = []
                with pipe, contextlib.suppress(EOFError, OSError):  # it died
                    outcome.append(pipe.recv())
                worker.process.join(_EXIT_SECONDS)
                cause = _cause(worker.process.exitcode)
                _end(running.pop(pipe))
                if outcome:
                    yield worker.item, outcome[0]
                elif worker.tries < _TRIES:
                    waiting.append((worker.item, worker.tries + 1))
                else:
                    yield worker.item, WorkerDied(f"its process died {_TRIES} times, the last time {cause}")
    finally:
        for worker in running.values():
            _end(worker)
        folder.cleanup()


def _end(worker: _Worker) -> None:
    assert worker.process.pid is not None
    with contextlib.suppress(ProcessLookupError, PermissionError):  # nothing of its group is left
        os.killpg(worker.process.pid, signal.SIGKILL)
    worker.process.kill()
    worker.process.join()


def _work(pipe: connection.Connection, call: bytes, folder: str) -> None:
    """Run one call in a worker, which leads a process group so that Ctrl-C reaches only the parent."""
    os.setsid()
    threading.Thread(target=_end_with_parent, daemon=True).start()
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # before the function's libraries are imported
    os.environ["TMPDIR"] = folder
    try:
        function, item = pickle.loads(call)
        pipe.send(function(item))
    except UserError as error:
        pipe.send(error)
    except (Exception, SystemExit) as error:  # the parent reports it and goes on with other items
        pipe.send(RuntimeError(_line(error)))


def _end_with_parent() -> None:
    """End this worker and all that it has started when its parent was killed."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    connection.wait([parent.sentinel])
    os.killpg(0, signal.SIGKILL)


def ray(
    function: Callable[[Item], Result],
    items: Sequence[Item],
    workers: int | None = None,
    address: str | None = None,
) -> Generator[tuple[Item, Result | Exception], None, None]:
    """Call a function on each item as a task with one CPU on a Ray cluster, which repeats lost tasks; yield as `local`.

    Every node must have this package, and find the files of the items under the same paths.

    Args:
        workers: number of simultaneous tasks; the number of CPUs of the cluster by default.
        address: address of the cluster; None for the one that $RAY_ADDRESS names or that runs on this machine, else a
            new one for this call.

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
    """Call in a new process, so that a crash does not end the Ray worker."""
    [(_, outcome)] = local(function, [item], 1)
    return outcome


def _cause(exit_code: int | None) -> str:
    if exit_code is None or exit_code >= 0:
        return f"with exit code {exit_code}"
    return f"of {signal_name(-exit_code)}" + (", as when memory runs out" if -exit_code == signal.SIGKILL else "")


def _line(error: BaseException) -> str:
    """Format an exception as one line: type, message, and where it was raised."""
    frames = traceback.extract_tb(error.__traceback__)
    place = f" [{pathlib.Path(frames[-1].filename).name}:{frames[-1].lineno}]" if frames else ""
    return f"{type(error).__name__}: {' '.join(str(error).split())}{place}"
