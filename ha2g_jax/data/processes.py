"""Work spread over processes, its results in the order of the tasks: how corpora are made and imported.

Ctrl-C is the parent's, which then ends its workers; they also end when the parent is killed.
"""

import collections
import concurrent.futures
import contextlib
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future
from multiprocessing import connection
from typing import Any, TypeVar

from ha2g_jax.errors import UserError

_TASKS_PER_WORKER = 2

Result = TypeVar("Result")


@contextlib.contextmanager
def parallel_map(count: int, died: str) -> Iterator[Callable[..., Iterator]]:
    """`map` that works in `count` processes; in this one, if that is 1.

    Args:
        count: of the processes.
        died: what to say if one of them dies.

    Raises:
        UserError: a process died.
    """
    if count == 1:
        yield map
        return
    with workers(count) as executor:
        yield lambda function, items: in_order(executor, function, ((item,) for item in items), count, died)


@contextlib.contextmanager
def workers(count: int) -> Iterator[Executor]:
    """Processes for `in_order`; at the end, waits for those that work and drops what waits."""
    # spawn: no state of this process, nor of an accelerator library, may reach the workers. A pool of
    # `multiprocessing` would wait for ever for a worker that has died.
    context = multiprocessing.get_context("spawn")
    executor = concurrent.futures.ProcessPoolExecutor(count, context, _begin_worker)
    try:
        yield executor
    finally:
        executor.shutdown(cancel_futures=True)


def in_order(
    executor: Executor, function: Callable[..., Result], tasks: Iterable[tuple[Any, ...]], count: int, died: str
) -> Iterator[Result]:
    """The results of `function(*task)` in the order of the tasks, of which few are under way at a time.

    Args:
        executor: from `workers`.
        function: importable by name.
        tasks: its arguments.
        count: of the workers.
        died: what to say if a worker dies.

    Raises:
        UserError: a worker died.
    """
    pending: collections.deque[Future[Result]] = collections.deque()
    try:
        for task in tasks:
            pending.append(_submit(executor, function, task))
            if len(pending) >= _TASKS_PER_WORKER * count:
                yield pending.popleft().result()
        while pending:
            yield pending.popleft().result()
    except concurrent.futures.BrokenExecutor as error:
        raise UserError(died) from error


def _submit(executor: Executor, function: Callable[..., Result], task: tuple[Any, ...]) -> Future[Result]:
    if sys.platform == "win32":
        return executor.submit(function, *task)
    # A worker that this starts inherits the block, so that it never sees Ctrl-C, not even while it starts.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        return executor.submit(function, *task)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin_worker() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    connection.wait([parent.sentinel])
    os._exit(1)
