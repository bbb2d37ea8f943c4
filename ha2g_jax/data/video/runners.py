"""Work on many items in parallel, on this machine or on a Ray cluster, where the death of a worker loses nothing."""

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

from ha2g_jax.errors import UserError

Item = TypeVar("Item")
Result = TypeVar("Result")

_TRIES = 2
_RAY_RETRIES = 3  # a cluster also loses whole nodes, which is no fault of an item
_EXIT_SECONDS = 10


class WorkerDied(Exception):
    """The process that worked on an item died, and so did the one that tried again; the message says of what."""


class _Worker(NamedTuple):
    process: SpawnProcess
    item: int
    tries: int


def local(
    function: Callable[[Item], Result], items: Sequence[Item], workers: int | None = None
) -> Generator[tuple[Item, Result | Exception], None, None]:
    """Calls a function on each item, each time in a process of its own.

    When a process dies (a crash in a library, no memory left), its item is tried once more. What a worker has started
    dies with it, and all workers die with this process, even if it is killed.

    Args:
        function: importable by name; runs with one thread of OpenMP, as on a cluster.
        items: can be pickled.
        workers: processes at the same time; one a core by default.

    Yields:
        (item, result) as they finish; the function's exception, or `WorkerDied`, in place of a result.
    """
    # spawn: no state of this process, nor of an accelerator library, may reach the workers.
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
    """Calls a function on each item as tasks of one CPU on a Ray cluster; a task whose node or worker dies is retried.

    Every node must have this package, and find the items' files under the same paths.

    Args:
        function: importable by name.
        items: can be pickled.
        workers: tasks at the same time; as many as the cluster has CPUs by default.
        address: of the cluster; None for the one that $RAY_ADDRESS names or that runs here, else one for this call.

    Yields:
        As `local`.

    Raises:
        UserError: Ray is not installed, or there is no cluster at the address.
    """
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    try:
        import ray as library
        from ray.exceptions import RayError
    except ImportError:
        raise UserError("--runner ray needs Ray; run: pip install 'ha2g-jax[ray]'") from None
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
                except RayError as error:
                    outcome = WorkerDied(f"its worker on the cluster died {_RAY_RETRIES + 1} times ({_line(error)})")
                del reference  # the cluster keeps a result in memory while this is held
                yield item, outcome
    finally:
        for reference in running:
            library.cancel(reference, force=True)
        if is_mine:
            library.shutdown()


def _call_apart(function: Callable[[Any], Any], item: Any) -> Any:
    """One call in a process of its own: a crash costs a try, not a Ray worker, and a killed worker leaves no orphan."""
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
    """What a worker does. It leads a process group, so that Ctrl-C reaches only the parent, which then ends it all."""
    os.setsid()
    _guard()
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # before the function's libraries are imported
    try:
        function, item = pickle.loads(call)
        pipe.send(function(item))
    except UserError as error:
        pipe.send(error)
    except (Exception, SystemExit) as error:  # another video must not suffer from it; the parent reports it
        pipe.send(RuntimeError(_line(error)))


def _guard() -> None:
    """Forks a process that ends the group, what the worker has started included, when the worker or its parent is gone.

    The worker could not: a Ray worker that ends, for one, kills its children without a word.
    """
    parent = multiprocessing.parent_process()
    assert parent is not None
    ours, _ = os.pipe()  # the other end closes with the worker, however that ends
    if os.fork():
        os.close(ours)
        return
    for number in {int(path.name) for path in pathlib.Path("/dev/fd").iterdir()} - {0, 1, 2, ours, parent.sentinel}:
        with contextlib.suppress(OSError):  # the one that listed the folder
            os.close(number)
    connection.wait([ours, parent.sentinel])
    os.killpg(0, signal.SIGKILL)


def _receive(pipe: connection.Connection, process: SpawnProcess) -> tuple[Any] | None:
    """What a worker has sent, None if it died before."""
    try:
        outcome = (pipe.recv(),)
    except (EOFError, OSError):
        return None
    process.join(_EXIT_SECONDS)
    return outcome


def _end(pipe: connection.Connection, process: SpawnProcess) -> None:
    """Ends a worker and whatever it has started, unless it has ended well."""
    if process.pid and process.exitcode != 0:  # a group outlives its leader, until all its members are gone
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
    """An exception as one line: kind, message, and where it was raised."""
    frames = traceback.extract_tb(error.__traceback__)
    place = f" [{pathlib.Path(frames[-1].filename).name}:{frames[-1].lineno}]" if frames else ""
    return f"{type(error).__name__}: {' '.join(str(error).split())}{place}"
