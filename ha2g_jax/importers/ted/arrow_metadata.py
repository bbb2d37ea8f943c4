"""Reader of the metadata of Arrow messages, flatbuffers of format version 4; every offset is checked before use.

A message is an int32 length, that many bytes of metadata, and a body. The metadata are a flatbuffer, which begins with
the offset of its root table. A table begins with the distance back to its vtable. A vtable has the size of itself and
of the table, and then the position in the table of each field in the order of Arrow's `Message.fbs`, `Schema.fbs` and
`Tensor.fbs` (0: the field has its default). Fields that are not numbers are stored as a forward offset to their data.
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
    """Error for bytes that are inconsistent or violate the format."""


class Message(NamedTuple):
    """The metadata of one message.

    Attributes:
        kind: SCHEMA, RECORD_BATCH or TENSOR.
        header: table of that kind.
        body_length: length of the body in bytes.
    """

    kind: int
    header: "Table"
    body_length: int


class Field(NamedTuple):
    """One field of a schema.

    Attributes:
        name: name of the field, may be empty.
        type: INT to UNION, or another number of Arrow's `Type`.
        dtype: numpy type of an INT or FLOAT, else None.
        children: fields inside a LIST (one), STRUCT or UNION.
    """

    name: str
    type: int
    dtype: np.dtype | None
    children: tuple["Field", ...]


class Layout(NamedTuple):
    """Layout of an array of numbers in the body of a message.

    Attributes:
        dtype: type of a number.
        shape: shape of the array, may be ().
        strides: strides in bytes, None for row-major order.
        offset: offset of the first number in the body, in bytes.
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
        """Return the number in a field of a `struct` format."""
        position = self._find(slot)
        return default if position is None else _unpack("<" + format, self.data, position)[0]

    def text(self, slot: int) -> str:
        """Return the text in a field."""
        start, length = self._vector(slot, 1)
        return self.data[start : start + length].decode()

    def table(self, slot: int) -> "Table":
        """Return the table in a field."""
        position = self._find(slot)
        if position is None:
            raise DamagedError("a table is missing in the metadata")
        return Table(self.data, position + _unpack("<I", self.data, position)[0])

    def tables(self, slot: int) -> list["Table"]:
        """Return the vector of tables in a field."""
        start, length = self._vector(slot, 4)
        offsets = _unpack(f"<{length}I", self.data, start)
        return [Table(self.data, start + 4 * index + offset) for index, offset in enumerate(offsets)]

    def pairs(self, slot: int) -> list[tuple[int, int]]:
        """Return the vector of pairs of int64 in a field."""
        start, length = self._vector(slot, 16)
        values = _unpack(f"<{2 * length}q", self.data, start)
        return list(zip(values[::2], values[1::2]))

    def numbers(self, slot: int) -> tuple[int, ...]:
        """Return the vector of int64 in a field."""
        start, length = self._vector(slot, 8)
        return _unpack(f"<{length}q", self.data, start)

    def _vector(self, slot: int, item_size: int) -> tuple[int, int]:
        """Return the start and the number of the items of a vector, (0, 0) if the field is missing."""
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
    """Split off the metadata of a message.

    Args:
        data: bytes that contain the message.
        position: start of the message.

    Returns:
        The metadata, and the position of the body.

    Raises:
        DamagedError: the data end within the metadata.
    """
    length = _unpack("<i", data, position)[0]
    start = position + 4
    if not 0 < length <= len(data) - start:
        raise DamagedError(f"metadata of {length} bytes at byte {position} of {len(data)}")
    return data[start : start + length], start + length


def read_message(metadata: bytes, kind: int) -> Message:
    """Read the metadata of a message.

    Args:
        metadata: bytes that `split_message` returns.
        kind: expected kind of the message.

    Raises:
        DamagedError: the metadata are damaged, or of another version or kind.
    """
    root = Table(metadata, _unpack("<I", metadata, 0)[0])
    version, found, body_length = root.number(0, "h"), root.number(1, "B"), root.number(3, "q")
    if version != _VERSION_4 or found != kind or body_length < 0:
        raise DamagedError(f"a message of version {version + 1}, kind {found}, not of version 4, kind {kind}")
    return Message(kind, root.table(2), body_length)


def read_schema(header: Table) -> tuple[Field, ...]:
    """Read the fields of a schema.

    Args:
        header: header of a message of kind SCHEMA.

    Raises:
        DamagedError: fields are nested too deeply, or have parts in common, which no writer does.
    """
    seen: set[int] = set()
    return tuple(_read_field(table, seen, 0) for table in header.tables(1))


def _read_field(table: Table, seen: set[int], depth: int) -> Field:
    # Fields with common parts could grow without bound when they are expanded.
    if depth > _MAX_DEPTH or table.position in seen:
        raise DamagedError("its values are nested too deeply")
    seen.add(table.position)
    type = table.number(2, "B")
    if type == UNION and table.table(3).number(0, "h") != _DENSE:
        raise DamagedError("a sparse union")
    children = tuple(_read_field(child, seen, depth + 1) for child in table.tables(5))
    return Field(table.text(0), type, _number_type(type, table, 3), children)


def read_layout(header: Table) -> Layout:
    """Read the layout of an array of numbers in the body of its message, without checking it against the body.

    Args:
        header: header of a message of kind TENSOR.

    Raises:
        DamagedError: the array does not hold numbers.
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
    """Return the numpy type of an INT or FLOAT that a field of the table describes, None for other types."""
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
