"""Reads LMDB databases in processes of their own, because the C library may crash on a damaged file."""

import collections
import concurrent.futures
import contextlib
import multiprocessing
import os
import pathlib
import signal
import struct
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future
from multiprocessing import connection
from typing import Any, NamedTuple, TypeVar

import lmdb

from ha2g_jax.errors import UserError

FILE = "data.mdb"

_PAGE_HEADER = struct.Struct("<QHHHH")  # number, padding, flags, bounds of the free space
_META_FLAG = 0x08
_MAGIC, _VERSION = 0xBEEFC0DE, 1
_TREE = "IHHQQQQQ"  # padding (page size), flags, depth, pages of three kinds, entries, root
_META = struct.Struct(f"<IIQQ{_TREE}{_TREE}QQ")  # magic, version, address, map size, two trees, last page, transaction
_TASKS_PER_WORKER = 2

Result = TypeVar("Result")


class _Meta(NamedTuple):
    page_size: int
    num_entries: int
    last_page: int
    transaction: int


def check(folder: pathlib.Path) -> int:
    """Checks that the file of a database is whole, without LMDB, which would read past its end.

    Returns:
        The number of records.

    Raises:
        UserError: there is no such file, it is no LMDB database, or it is shorter than it says.
    """
    path = folder / FILE
    try:
        if not path.is_file():
            raise UserError(f"{folder} has no {FILE}; name a folder of an LMDB database")
        size = path.stat().st_size
        with path.open("rb") as file:
            first = _read_meta(file.read(_PAGE_HEADER.size + _META.size))
            if first is not None:
                file.seek(first.page_size)
            second = _read_meta(file.read(_PAGE_HEADER.size + _META.size))
    except OSError as error:
        raise UserError(f"{path} cannot be read ({error.strerror}); check its permissions") from error
    if first is None or second is None:
        raise UserError(f"{path} ({size} bytes) is no LMDB database or damaged; copy or download it again")
    newest = max(first, second, key=lambda meta: meta.transaction)
    expected = (newest.last_page + 1) * newest.page_size
    if size < expected:
        raise UserError(f"{path} has {size} bytes instead of {expected}; copy or download it again")
    return newest.num_entries


def _read_meta(data: bytes) -> _Meta | None:
    """What a meta page says; None if it is none."""
    if len(data) < _PAGE_HEADER.size + _META.size:
        return None
    _, _, flags, _, _ = _PAGE_HEADER.unpack_from(data)
    fields = _META.unpack_from(data, _PAGE_HEADER.size)
    page_size, num_entries = fields[4], fields[18]
    is_meta = flags & _META_FLAG and fields[0] == _MAGIC and fields[1] == _VERSION
    # LMDB's own limits of the page size.
    if not is_meta or page_size not in (2**power for power in range(8, 17)):
        return None
    return _Meta(page_size, num_entries, last_page=fields[20], transaction=fields[21])


def read_keys(folder: pathlib.Path) -> list[bytes]:
    """All keys in their order. Only for a worker: a damaged file may end the process.

    Raises:
        UserError: LMDB finds the file damaged.
    """
    keys: list[bytes] = []
    with _transaction(folder) as transaction:
        for key in transaction.cursor().iternext(keys=True, values=False):
            # Pages that lead back to each other would never end; their keys do not ascend.
            if keys and bytes(key) <= keys[-1]:
                raise UserError(f"{folder / FILE} is damaged (keys out of order); copy or download it again")
            keys.append(bytes(key))
    return keys


def read_value(folder: pathlib.Path, key: bytes) -> bytes:
    """The value of a key. Only for a worker: a damaged file may end the process.

    Raises:
        UserError: LMDB finds the file damaged.
    """
    with _transaction(folder) as transaction:
        value = transaction.get(key)
        if value is None or len(value) > (folder / FILE).stat().st_size:
            raise UserError(f"{folder / FILE} is damaged (record {key!r}); copy or download it again")
        return bytes(value)


@contextlib.contextmanager
def _transaction(folder: pathlib.Path) -> Iterator[lmdb.Transaction]:
    try:
        # A map of the file's size: without it LMDB would map as much as the file declares.
        size = (folder / FILE).stat().st_size
        with (
            # Read ahead by the system: values are large and come one after the other, 30 times as fast from a disk.
            lmdb.open(str(folder), map_size=size, readonly=True, lock=False, create=False) as database,
            database.begin(buffers=True) as transaction,
        ):
            yield transaction
    except lmdb.Error as error:
        raise UserError(f"{folder / FILE} is damaged ({error}); copy or download it again") from error


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
    executor: Executor, function: Callable[..., Result], tasks: Iterable[tuple[Any, ...]], count: int, name: str
) -> Iterator[Result]:
    """The results of `function(*task)` in the order of the tasks, of which few are under way at a time.

    Args:
        executor: from `workers`.
        function: importable by name.
        tasks: its arguments.
        count: of the workers.
        name: of the file that the tasks read.

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
        raise UserError(
            f"a process that read {name} died: the file is damaged (copy or download it again), "
            "or memory ran out (use fewer workers)"
        ) from error


def _submit(executor: Executor, function: Callable[..., Result], task: tuple[Any, ...]) -> Future[Result]:
    # A worker that this starts inherits the block: Ctrl-C is the parent's, which then ends its workers.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        return executor.submit(function, *task)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin_worker() -> None:
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    connection.wait([parent.sentinel])
    os._exit(1)
