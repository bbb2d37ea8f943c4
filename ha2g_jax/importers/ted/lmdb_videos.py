"""Reader of LMDB databases, to be used in worker processes, because the C library may crash on a damaged file."""

import contextlib
import os
import pathlib
import struct
from collections.abc import Iterator
from typing import NamedTuple

import lmdb

from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import shown

FILE = "data.mdb"

_PAGE_HEADER = struct.Struct("<QHHHH")  # number, padding, flags, bounds of the free space
_META_FLAG = 0x08
_MAGIC, _VERSION = 0xBEEFC0DE, 1
_TREE = "IHHQQQQQ"  # padding (page size), flags, depth, numbers of pages of three kinds, entries, root
_META = struct.Struct(f"<IIQQ{_TREE}{_TREE}QQ")  # magic, version, address, map size, two trees, last page, transaction


class _Meta(NamedTuple):
    page_size: int
    num_entries: int
    last_page: int
    transaction: int


def check(folder: pathlib.Path) -> int:
    """Check that the file of a database is complete, without LMDB, which would read past its end.

    Args:
        folder: folder of the database.

    Returns:
        The number of records.

    Raises:
        UserError: there is no such file, it is not an LMDB database, or it is shorter than it declares.
    """
    path = folder / FILE
    try:
        if not path.is_file():
            raise UserError(f"{shown(folder)} has no {FILE}; name a folder of an LMDB database")
        size = path.stat().st_size
        with path.open("rb") as file:
            first = _read_meta(file.read(_PAGE_HEADER.size + _META.size))
            if first is not None:
                file.seek(first.page_size)
            second = _read_meta(file.read(_PAGE_HEADER.size + _META.size))
    except OSError as error:
        raise UserError(f"{shown(path)} cannot be read ({error.strerror}); check its permissions") from error
    if first is None or second is None:
        raise UserError(f"{shown(path)} ({size} bytes) is not an LMDB database or damaged; copy or download it again")
    newest = max(first, second, key=lambda meta: meta.transaction)
    expected = (newest.last_page + 1) * newest.page_size
    if size < expected:
        raise UserError(f"{shown(path)} has {size} bytes instead of {expected}; copy or download it again")
    return newest.num_entries


def _read_meta(data: bytes) -> _Meta | None:
    """Read a meta page, None if the data are not a meta page."""
    if len(data) < _PAGE_HEADER.size + _META.size:
        return None
    _, _, flags, _, _ = _PAGE_HEADER.unpack_from(data)
    fields = _META.unpack_from(data, _PAGE_HEADER.size)
    page_size, num_entries = fields[4], fields[18]
    is_meta = flags & _META_FLAG and fields[0] == _MAGIC and fields[1] == _VERSION
    # LMDB allows these page sizes.
    if not is_meta or page_size not in (2**power for power in range(8, 17)):
        return None
    return _Meta(page_size, num_entries, last_page=fields[20], transaction=fields[21])


def read_keys(folder: pathlib.Path) -> list[bytes]:
    """Read all keys in order. Call it in a worker only, because a damaged file may end the process.

    Args:
        folder: folder of the database.

    Raises:
        UserError: LMDB finds the file damaged.
    """
    keys: list[bytes] = []
    with _transaction(folder) as transaction:
        for key in transaction.cursor().iternext(keys=True, values=False):
            # Keys that do not ascend reveal damaged pages that refer to each other and would never end.
            if keys and bytes(key) <= keys[-1]:
                raise UserError(f"{shown(folder / FILE)} is damaged (keys out of order); copy or download it again")
            keys.append(bytes(key))
    if len(keys) != (expected := check(folder)):
        raise UserError(
            f"{shown(folder / FILE)} is damaged ({len(keys)} of {expected} records); copy or download it again"
        )
    return keys


def read_value(folder: pathlib.Path, key: bytes) -> bytes:
    """Read the value of a key. Call it in a worker only, because a damaged file may end the process.

    Args:
        folder: folder of the database.
        key: key of the value.

    Raises:
        UserError: LMDB finds the file damaged.
    """
    with _transaction(folder) as transaction:
        value = transaction.get(key)
        if value is None or len(value) > (folder / FILE).stat().st_size:
            raise UserError(f"{shown(folder / FILE)} is damaged (record {key!r}); copy or download it again")
        return bytes(value)


@contextlib.contextmanager
def _transaction(folder: pathlib.Path) -> Iterator[lmdb.Transaction]:
    try:
        # The map has the size of the file; otherwise LMDB would map as much as the file declares.
        size = (folder / FILE).stat().st_size
        with (
            # With read-ahead of the system, because values are large and sequential: 30 times as fast from a disk.
            lmdb.open(os.fsencode(folder), map_size=size, readonly=True, lock=False, create=False) as database,
            database.begin(buffers=True) as transaction,
        ):
            yield transaction
    except lmdb.Error as error:
        raise UserError(f"{shown(folder / FILE)} is damaged ({error}); copy or download it again") from error
