"""Sizes of the records of an ArrayRecord shard, read before anything is unpacked.

A shard is a Riegeli file: blocks of 64 KiB, each of which starts with a header of 24 bytes, and over these blocks runs
a sequence of chunks. The header of a chunk states how many bytes its records take when they are unpacked. See
https://github.com/google/riegeli/blob/master/doc/riegeli_records_file_format.md.
"""

import os
import pathlib
import struct
from collections.abc import Iterator
from typing import BinaryIO

from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import reason, shown
from ha2g_jax.limits import MAX_CLIP_BYTES

_BLOCK, _BLOCK_HEADER = 1 << 16, 24
_CONTENT = _BLOCK - _BLOCK_HEADER  # bytes of chunks in a block
_CHUNK_HEADER = struct.Struct("<QQQQQ")


def check_sizes(shard: pathlib.Path) -> None:
    """Check that no chunk of a shard unpacks to more than `MAX_CLIP_BYTES`.

    Args:
        shard: an ArrayRecord file. Damage is left to its reader: the check ends where no chunk can start.

    Raises:
        UserError: a chunk is larger, or the file cannot be read.
    """
    try:
        with shard.open("rb") as file:
            largest = max(_unpacked_sizes(file), default=0)
    except OSError as error:
        raise UserError(f"{shown(shard)} cannot be read ({reason(error)})") from error
    if largest > MAX_CLIP_BYTES:
        raise UserError(
            f"{shown(shard)} cannot be read (a record unpacks to {largest} bytes, more than {MAX_CLIP_BYTES}); "
            "make or import the corpus again"
        )


def _unpacked_sizes(file: BinaryIO) -> Iterator[int]:
    """Yield the bytes that each chunk takes when it is unpacked."""
    length = file.seek(0, os.SEEK_END)
    position = 0  # counted without the headers of blocks
    while _file_position(position) < length and len(header := _read(file, position)) == _CHUNK_HEADER.size:
        _, data_size, _, kind_and_count, size = _CHUNK_HEADER.unpack(header)
        count = kind_and_count >> 8
        # A chunk takes at least as many bytes of the file as it has records, so that each has a position of its own.
        position = max(position + _CHUNK_HEADER.size + data_size, _content_before(_file_position(position) + count))
        yield size


def _read(file: BinaryIO, position: int) -> bytes:
    """Return the bytes of a header of a chunk, which may run from one block into the next."""
    size, start = _CHUNK_HEADER.size, _file_position(position)
    file.seek(start)
    data = file.read(size + _BLOCK_HEADER)
    here = min(size, _BLOCK - start % _BLOCK)  # bytes before the next block
    return (data[:here] + data[here + _BLOCK_HEADER :])[:size] if here < size else data[:size]


def _file_position(position: int) -> int:
    block, offset = divmod(position, _CONTENT)
    return block * _BLOCK + _BLOCK_HEADER + offset


def _content_before(file_position: int) -> int:
    block, offset = divmod(file_position, _BLOCK)
    return block * _CONTENT + max(offset - _BLOCK_HEADER, 0)
