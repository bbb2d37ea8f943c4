"""The metadata of Arrow messages, flatbuffers tables of format version 4, with every offset checked before it is used.

A message is an int32 length, that many bytes of metadata, and a body. The metadata are a flatbuffer: it begins with the
offset of its root table; a table begins with the distance back to its vtable, which holds the size of itself and of the
table and then, for each field in the order of Arrow's `Message.fbs`, `Schema.fbs` and `Tensor.fbs`, where in the table
it lies (0: it has its default). Whatever else is not a number is an offset forward to it.
"""

import struct
from typing import NamedTuple

import numpy as np

SCHEMA, RECORD_BATCH, TENSOR = 1, 3, 4  # kinds of message
INT, FLOAT, BINARY, TEXT, BOOL, LIST, STRUCT, UNION = 2, 3, 4, 5, 6, 12, 13, 14  # types of a field

_VERSION_4 = 3
_DENSE = 1
_MAX_DEPTH = 64
_FLOATS = {0: np.dtype("<f2"), 1: np.dtype("<f4"), 2: np.dtype("<f8")}
_INTS = {(bits, signed): np.dtype(f"<{'ui'[signed]}{bits // 8}") for bits in (8, 16, 32, 64) for signed in (0, 1)}


class DamagedError(ValueError):
    """The bytes contradict themselves or the format."""


class Message(NamedTuple):
    """One message.

    Attributes:
        kind: SCHEMA, RECORD_BATCH or TENSOR.
        header: the table of that kind.
        body_length: bytes of the body.
    """

    kind: int
    header: "Table"
    body_length: int


class Field(NamedTuple):
    """One field of a schema.

    Attributes:
        name: may be empty.
        type: INT to UNION, or another number of Arrow's `Type`.
        dtype: of INT and FLOAT.
        children: of LIST (one), STRUCT and UNION.
    """

    name: str
    type: int
    dtype: np.dtype | None
    children: tuple["Field", ...]


class Layout(NamedTuple):
    """How an array of numbers lies in the body of a message.

    Attributes:
        dtype: type of a number.
        shape: may be ().
        strides: in bytes; None where the numbers lie row by row.
        offset: of the first number in the body.
    """

    dtype: np.dtype
    shape: tuple[int, ...]
    strides: tuple[int, ...] | None
    offset: int


class Table(NamedTuple):
    """A table within the metadata of a message; `slot` counts the fields of its kind from 0."""

    data: bytes
    position: int

    def number(self, slot: int, format: str, default: int = 0) -> int:
        position = self._find(slot)
        return default if position is None else _unpack("<" + format, self.data, position)[0]

    def text(self, slot: int) -> str:
        start, length = self._vector(slot, 1)
        return self.data[start : start + length].decode()

    def table(self, slot: int) -> "Table":
        position = self._find(slot)
        if position is None:
            raise DamagedError("a table is missing in the metadata")
        return Table(self.data, position + _unpack("<I", self.data, position)[0])

    def tables(self, slot: int) -> list["Table"]:
        start, length = self._vector(slot, 4)
        offsets = _unpack(f"<{length}I", self.data, start)
        return [Table(self.data, start + 4 * index + offset) for index, offset in enumerate(offsets)]

    def pairs(self, slot: int) -> list[tuple[int, int]]:
        """A vector of structs of two int64."""
        start, length = self._vector(slot, 16)
        values = _unpack(f"<{2 * length}q", self.data, start)
        return list(zip(values[::2], values[1::2]))

    def numbers(self, slot: int) -> tuple[int, ...]:
        """A vector of int64."""
        start, length = self._vector(slot, 8)
        return _unpack(f"<{length}q", self.data, start)

    def _vector(self, slot: int, item_size: int) -> tuple[int, int]:
        """Start and number of the items of a vector; none where it is missing."""
        position = self._find(slot)
        if position is None:
            return 0, 0
        start = position + _unpack("<I", self.data, position)[0]
        length = _unpack("<I", self.data, start)[0]
        if length * item_size > len(self.data) - start - 4:
            raise DamagedError(f"a list of {length} items does not fit into its metadata")
        return start + 4, length

    def _find(self, slot: int) -> int | None:
        vtable = self.position - _unpack("<i", self.data, self.position)[0]
        if 4 + 2 * slot >= _unpack("<H", self.data, vtable)[0]:
            return None
        offset = _unpack("<H", self.data, vtable + 4 + 2 * slot)[0]
        return self.position + offset if offset else None


def split_message(data: bytes, position: int) -> tuple[bytes, int]:
    """The metadata of the message at `position`, and where its body starts.

    Raises:
        DamagedError: the data end before.
    """
    length = _unpack("<i", data, position)[0]
    start = position + 4
    if not 0 < length <= len(data) - start:
        raise DamagedError(f"metadata of {length} bytes at byte {position} of {len(data)}")
    return data[start : start + length], start + length


def read_message(metadata: bytes, kind: int) -> Message:
    """The message with these metadata.

    Raises:
        DamagedError: they are damaged, or of another version or kind of message.
    """
    root = Table(metadata, _unpack("<I", metadata, 0)[0])
    version, found, body_length = root.number(0, "h"), root.number(1, "B"), root.number(3, "q")
    if version != _VERSION_4 or found != kind or body_length < 0:
        raise DamagedError(f"a message of version {version + 1}, kind {found}, not of version 4, kind {kind}")
    return Message(kind, root.table(2), body_length)


def read_schema(header: Table) -> tuple[Field, ...]:
    """The fields of a schema.

    Raises:
        DamagedError: they are nested too deeply, or share parts, as no writer makes them.
    """
    seen: set[int] = set()
    return tuple(_read_field(table, seen, 0) for table in header.tables(1))


def _read_field(table: Table, seen: set[int], depth: int) -> Field:
    # Shared parts could grow without bound when they are expanded.
    if depth > _MAX_DEPTH or table.position in seen:
        raise DamagedError("its values are nested too deeply")
    seen.add(table.position)
    type = table.number(2, "B")
    if type == UNION and table.table(3).number(0, "h") != _DENSE:
        raise DamagedError("a sparse union")
    children = tuple(_read_field(child, seen, depth + 1) for child in table.tables(5))
    return Field(table.text(0), type, _number_type(type, table, 3), children)


def read_layout(header: Table) -> Layout:
    """How an array of numbers lies in the body of its message; not checked against the body.

    Raises:
        DamagedError: it does not hold numbers.
    """
    dtype = _number_type(header.number(0, "B"), header, 1)
    if dtype is None:
        raise DamagedError("an array that does not hold numbers")
    shape = tuple(dimension.number(0, "q") for dimension in header.tables(2))
    strides = header.numbers(3)
    if strides and len(strides) != len(shape):
        raise DamagedError(f"{len(strides)} strides of {len(shape)} dimensions")
    return Layout(dtype, shape, strides or None, header.number(4, "q"))


def _number_type(type: int, table: Table, slot: int) -> np.dtype | None:
    """The numpy type of an INT or FLOAT that `slot` of the table describes; None for other types."""
    if type == FLOAT:
        return _FLOATS.get(table.table(slot).number(0, "h"))
    if type == INT:
        described = table.table(slot)
        return _INTS.get((described.number(0, "i"), described.number(1, "B")))
    return None


def _unpack(format: str, data: bytes, position: int) -> tuple[int, ...]:
    if not 0 <= position <= len(data) - struct.calcsize(format):
        raise DamagedError(f"an offset to {position}, outside of {len(data)} bytes of metadata")
    return struct.unpack_from(format, data, position)
