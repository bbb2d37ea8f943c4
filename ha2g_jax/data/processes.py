"""Parallel work in processes that end with their parent, with results in the order of the tasks."""

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
    """Provide a `map`, with results in order, that runs in `count` processes, or in this process if `count` is 1.

    The mapped function must be importable by name.

    Raises:
        UserError: a process died; the message is `died`.
    """
    if count == 1:
        yield map
        return
    with workers(count) as executor:
        yield lambda function, items: in_order(executor, function, ((item,) for item in items), count, died)


@contextlib.contextmanager
def workers(count: int) -> Iterator[Executor]:
    """Start processes for `in_order`; at the end, wait for running tasks and drop waiting ones."""
    # spawn: the workers must not inherit state of this process or of an accelerator library. A pool of
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
    """Yield the results of `function(*task)` in the order of the tasks, with few tasks in progress at a time.

    The executor is that of `workers` with `count` processes, and the function is importable by name.

    Raises:
        UserError: a worker died; the message is `died`.
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
    # A worker started here inherits the blocked signal, so Ctrl-C does not reach it even while it starts.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        return executor.submit(function, *task)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin_worker() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=end_with_parent, daemon=True).start()


def end_with_parent() -> None:
    """End this worker when its parent is killed; otherwise it would wait for ever."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    connection.wait([parent.sentinel])
    os._exit(1)
