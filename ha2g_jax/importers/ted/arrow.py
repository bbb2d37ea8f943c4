"""Reader of values serialized by `pyarrow.serialize` of pyarrow 0.14, which current versions cannot read.

It uses neither pyarrow nor pickle, and checks every offset before use. The layout, little-endian:

    int32 x 3     number of tensors, arrays (numpy) and buffers; only arrays are read here
    padding to 8 bytes
    an Arrow stream: the message of a schema, that of a record batch, int32 0
    padding to 64 bytes, then each array: its message, whose body is the numbers, and padding to 64 bytes

The batch has one column, a dense union, whose only row is the value. A union has a child for each kind of Python value
in it; the name of the child is the number of the kind. A list is a row of a list array over a union, which has the
items of all lists at that level; a dict is a row of a list array over a struct of two unions, keys and values. A null
row of a union is None. An array is an index into the arrays at the end. Objects of other types are dicts with the key
"_pytype_", mostly pickled.

A message is an int32 length, that many bytes of metadata, and a body. The metadata are a flatbuffer of version 4, which
begins with the offset of its root table. A table begins with the distance back to its vtable. A vtable has the
size of itself and of the table, and then the position in the table of each field in the order of Arrow's `Message.fbs`,
`Schema.fbs` and `Tensor.fbs` (0: the field has its default). Fields that are not numbers are stored as a forward offset
to their data.
"""

import math
import struct
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from ha2g_jax.errors import UserError

# Kinds of Python values.
_BOOL, _BYTES, _STRING, _LIST, _DICT, _TUPLE, _ARRAY = 0, 3, 4, 9, 10, 11, 14
_NUMBERS = {1: np.dtype("<i8"), 2: np.dtype("<i8"), 5: np.dtype("<f2"), 6: np.dtype("<f4"), 7: np.dtype("<f8")}
_INDEX = np.dtype("<i4")
_PICKLED = "_pytype_"
# Functions that return the Python values of some rows of an Arrow array, and of a range of rows of a union.
_Rows: TypeAlias = Callable[[np.ndarray], Sequence[Any]]
_Range: TypeAlias = Callable[[int, int], list[Any]]

_SCHEMA, _RECORD_BATCH, _TENSOR = 1, 3, 4  # kinds of message
# Types of a field.
_ARROW_INT, _ARROW_FLOAT, _ARROW_BINARY, _ARROW_TEXT = 2, 3, 4, 5
_ARROW_BOOL, _ARROW_LIST, _ARROW_STRUCT, _ARROW_UNION = 6, 12, 13, 14
_VERSION_4 = 3
_DENSE = 1
_MAX_DEPTH = 64
_FLOATS = {0: np.dtype("<f2"), 1: np.dtype("<f4"), 2: np.dtype("<f8")}
_INTS = {(bits, signed): np.dtype(f"<{'ui'[signed]}{bits // 8}") for bits in (8, 16, 32, 64) for signed in (0, 1)}


class _OtherTypeError(Exception):
    """Error for a value that only pyarrow or pickle can read."""


def deserialize(data: bytes, name: str) -> Any:
    """Deserialize a value that `pyarrow.serialize(value).to_buffer()` of pyarrow 0.14 has serialized.

    Returns:
        None, bool, int, float, str, bytes; lists, tuples and dicts of these; arrays, which are read-only views of
        `data`. All together take at most about ten times the memory of `data`, whatever it declares.

    Raises:
        UserError: the bytes are damaged, or hold an object of another type.
    """
    try:
        return _read(data)
    except _OtherTypeError as error:
        raise UserError(f"{name} holds {error}, which is never unpacked; expected text, numbers and arrays") from error
    # numpy and Python raise the last ones for shapes, indices, texts and keys that no writer makes.
    except (_DamagedError, ValueError, IndexError, TypeError, OverflowError) as error:
        reason = " ".join(str(error).split())
        raise UserError(f"{name} is damaged or not of pyarrow 0.14 ({reason}); copy or download it again") from error


class _DamagedError(ValueError):
    """Error for bytes that are inconsistent or violate the format."""


class _Table(NamedTuple):
    """A table within the metadata of a message; `slot` counts the fields of its kind from 0."""

    data: bytes
    position: int

    def number(self, slot: int, format: str) -> int:
        position = self._find(slot)
        return 0 if position is None else _unpack("<" + format, self.data, position)[0]

    def text(self, slot: int) -> str:
        start, length = self._vector(slot, 1)
        return self.data[start : start + length].decode()

    def table(self, slot: int) -> "_Table":
        position = self._find(slot)
        if position is None:
            raise _DamagedError("a table is missing in the metadata")
        return _Table(self.data, position + _unpack("<I", self.data, position)[0])

    def tables(self, slot: int) -> list["_Table"]:
        start, length = self._vector(slot, 4)
        offsets = _unpack(f"<{length}I", self.data, start)
        return [_Table(self.data, start + 4 * index + offset) for index, offset in enumerate(offsets)]

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
            raise _DamagedError(f"a list of {length} items does not fit into its metadata")
        return start + 4, length

    def _find(self, slot: int) -> int | None:
        vtable = self.position - _unpack("<i", self.data, self.position)[0]
        if 4 + 2 * slot >= _unpack("<H", self.data, vtable)[0]:
            return None
        offset = _unpack("<H", self.data, vtable + 4 + 2 * slot)[0]
        return self.position + offset if offset else None


class _Field(NamedTuple):
    name: str  # may be empty
    type: int  # a number of Arrow's `Type`
    dtype: np.dtype | None  # of an INT or FLOAT
    children: tuple["_Field", ...]


class _Layout(NamedTuple):
    dtype: np.dtype
    shape: tuple[int, ...]
    strides: tuple[int, ...] | None  # in bytes, None for row-major order
    offset: int  # of the first number in the body, in bytes


def _read(data: bytes) -> Any:
    if len(data) < 16:
        raise _DamagedError(f"{len(data)} bytes are too few")
    num_tensors, num_arrays, num_buffers = struct.unpack_from("<iii", data)
    metadata, start = _split_message(data, 16)
    fields = _read_schema(_read_message(metadata, _SCHEMA)[0])
    metadata, start = _split_message(data, start)
    batch, length = _read_message(metadata, _RECORD_BATCH)
    end = _end(data, start, length)
    if num_tensors or num_buffers:
        raise _OtherTypeError("tensors or buffers of pyarrow")
    if len(fields) != 1:
        raise _DamagedError(f"{len(fields)} columns")
    arrays = _read_arrays(data, _aligned(end + 4), num_arrays)
    value = _Batch(memoryview(data)[start:end], batch, arrays, len(data)).union(fields[0])
    return value(0, 1)[0]


def _read_arrays(data: bytes, position: int, count: int) -> list[np.ndarray]:
    arrays: list[np.ndarray] = []
    # Thousands of arrays of one shape have the same metadata.
    layouts: dict[bytes, tuple[_Layout, int]] = {}
    for _ in range(count):
        metadata, start = _split_message(data, position)
        if metadata not in layouts:
            layouts[metadata] = _checked_layout(metadata)
        layout, length = layouts[metadata]
        end = _end(data, start, length)
        arrays.append(np.ndarray(layout.shape, layout.dtype, data, start + layout.offset, layout.strides))
        position = _aligned(end)
    return arrays


def _checked_layout(metadata: bytes) -> tuple[_Layout, int]:
    """Return the layout of an array, checked to lie inside the body of its message, and the length of the body."""
    header, length = _read_message(metadata, _TENSOR)
    layout = _read_layout(header)
    size, itemsize = math.prod(layout.shape), layout.dtype.itemsize
    last = sum((count - 1) * stride for count, stride in zip(layout.shape, layout.strides or ()))
    # The first term refuses overlapping rows, with which an array could be larger than its bytes; no writer makes them.
    needed = layout.offset + (max(size * itemsize, last + itemsize) if size else 0)
    if min(0, *layout.shape, *(layout.strides or ()), layout.offset) < 0 or needed > length:
        raise _DamagedError(f"an array of shape {layout.shape} in {length} bytes")
    return layout, length


class _Batch:
    """Reader of the arrays of a record batch, which must be read in the order in which they are stored."""

    def __init__(self, body: memoryview, header: _Table, arrays: list[np.ndarray], budget: int):
        self._body, self._arrays = body, arrays
        self._nodes, self._buffers = iter(header.pairs(1)), iter(header.pairs(2))
        # Bytes of values that may still be created, because rows that are used repeatedly could exceed the memory.
        self._budget = budget

    def union(self, field: _Field) -> _Range:
        if field.type != _ARROW_UNION:
            raise _DamagedError(f"an array of type {field.type} instead of a union")
        length, num_nulls = self._node()
        bitmap = self._bytes()
        kinds, rows = self._buffer(np.dtype("i1"), length), self._buffer(np.dtype("<u4"), length)
        is_valid = _bits(bitmap, length) if num_nulls else np.ones(length, bool)
        children = [self._child(child) for child in field.children]

        def values(start: int, end: int) -> list[Any]:
            if not 0 <= start <= end <= length:
                raise _DamagedError(f"items {start} to {end} of {length}")
            self._spend(end - start)
            values: list[Any] = [None] * (end - start)
            own_kinds, own_rows = kinds[start:end], rows[start:end]
            for kind in set(own_kinds[is_valid[start:end]].tolist()):
                if not 0 <= kind < len(children):
                    raise _DamagedError(f"child {kind} of {len(children)}")
                places = np.flatnonzero(is_valid[start:end] & (own_kinds == kind))
                for place, value in zip(places.tolist(), children[kind](own_rows[places]), strict=True):
                    values[place] = value
            return values

        return values

    def _child(self, field: _Field) -> _Rows:
        kind = int(field.name)
        length, _ = self._node()
        self._bytes()  # the bitmap of nulls: only unions have some
        if kind == _BOOL and field.type == _ARROW_BOOL:
            bits = _bits(self._bytes(), length)
            return lambda rows: bits[rows].tolist()
        if kind in _NUMBERS and field.dtype == _NUMBERS[kind]:
            numbers = self._buffer(_NUMBERS[kind], length)
            return lambda rows: numbers[rows].tolist()
        if kind == _ARRAY and field.dtype == _INDEX:
            indices = self._buffer(_INDEX, length)
            return lambda rows: [self._array(index) for index in indices[rows].tolist()]
        if (kind, field.type) in ((_STRING, _ARROW_TEXT), (_BYTES, _ARROW_BINARY)):
            return self._texts(kind, self._buffer(_INDEX, length + 1))
        if kind in (_LIST, _TUPLE, _DICT) and field.type == _ARROW_LIST and len(field.children) == 1:
            return self._containers(kind, self._buffer(_INDEX, length + 1), field.children[0])
        raise _OtherTypeError(f"Python objects of kind {kind} as Arrow type {field.type}")

    def _texts(self, kind: int, ends: np.ndarray) -> _Rows:
        text = self._bytes()

        def values(rows: np.ndarray) -> list[str] | list[bytes]:
            texts: list[bytes] = []
            for start, end in _ranges(ends, rows):
                if not 0 <= start <= end <= len(text):
                    raise _DamagedError(f"a text from {start} to {end} in {len(text)} bytes")
                self._spend(end - start)
                texts.append(bytes(text[start:end]))
            return [text.decode() for text in texts] if kind == _STRING else texts

        return values

    def _containers(self, kind: int, ends: np.ndarray, items: _Field) -> _Rows:
        if kind != _DICT:
            container, union = list if kind == _LIST else tuple, self.union(items)
            return lambda rows: [container(union(start, end)) for start, end in _ranges(ends, rows)]
        if items.type != _ARROW_STRUCT or len(items.children) != 2:
            raise _DamagedError("a dict without keys and values")
        self._node()
        self._bytes()
        keys, values = (self.union(child) for child in items.children)
        return lambda rows: [_make_dict(keys(*span), values(*span)) for span in _ranges(ends, rows)]

    def _array(self, index: int) -> np.ndarray:
        if not 0 <= index < len(self._arrays):
            raise _DamagedError(f"array {index} of {len(self._arrays)}")
        self._spend(self._arrays[index].nbytes)
        return self._arrays[index]

    def _spend(self, size: int) -> None:
        self._budget -= size
        if self._budget < 0:
            raise _DamagedError("its values are larger than itself")

    def _node(self) -> tuple[int, int]:
        length, num_nulls = next(self._nodes, (-1, -1))
        if length < 0:
            raise _DamagedError("arrays are missing")
        return length, num_nulls

    def _buffer(self, dtype: np.dtype, length: int) -> np.ndarray:
        buffer = self._bytes()
        if length * dtype.itemsize > len(buffer):
            raise _DamagedError(f"{length} items of {dtype.itemsize} bytes in {len(buffer)} bytes")
        return np.frombuffer(buffer[: length * dtype.itemsize], dtype)

    def _bytes(self) -> memoryview:
        offset, length = next(self._buffers, (-1, -1))
        if offset < 0 or length < 0 or offset + length > len(self._body):
            raise _DamagedError(f"bytes {offset} to {offset + length} of {len(self._body)}")
        return self._body[offset : offset + length]


def _bits(bitmap: memoryview, length: int) -> np.ndarray:
    if length > 8 * len(bitmap):
        raise _DamagedError(f"{length} bits in {len(bitmap)} bytes")
    return np.unpackbits(np.frombuffer(bitmap, np.uint8), count=length, bitorder="little").view(bool)


def _make_dict(keys: list[Any], values: list[Any]) -> dict[Any, Any]:
    made = dict(zip(keys, values, strict=True))
    if _PICKLED in made:
        raise _OtherTypeError(f"an object of type {str(made[_PICKLED])[:40]!r}")
    return made


def _ranges(ends: np.ndarray, rows: np.ndarray) -> list[tuple[int, int]]:
    return list(zip(ends[:-1][rows].tolist(), ends[1:][rows].tolist(), strict=True))


def _end(data: bytes, start: int, length: int) -> int:
    if length > len(data) - start:
        raise _DamagedError(f"it ends after {len(data)} bytes, not {start + length}")
    return start + length


def _aligned(position: int) -> int:
    return -(-position // 64) * 64


def _split_message(data: bytes, position: int) -> tuple[bytes, int]:
    """Return the metadata of the message at a position, and the position of its body."""
    length = _unpack("<i", data, position)[0]
    start = position + 4
    if not 0 < length <= len(data) - start:
        raise _DamagedError(f"metadata of {length} bytes at byte {position} of {len(data)}")
    return data[start : start + length], start + length


def _read_message(metadata: bytes, kind: int) -> tuple[_Table, int]:
    """Return the header of a message of the expected kind, and the length of its body."""
    root = _Table(metadata, _unpack("<I", metadata, 0)[0])
    version, found, body_length = root.number(0, "h"), root.number(1, "B"), root.number(3, "q")
    if version != _VERSION_4 or found != kind or body_length < 0:
        raise _DamagedError(f"a message of version {version + 1}, kind {found}, not of version 4, kind {kind}")
    return root.table(2), body_length


def _read_schema(header: _Table) -> tuple[_Field, ...]:
    """Return the fields of a schema, which are not nested too deeply and have no parts in common."""
    seen: set[int] = set()
    return tuple(_read_field(table, seen, 0) for table in header.tables(1))


def _read_field(table: _Table, seen: set[int], depth: int) -> _Field:
    # Fields with common parts could grow without bound when they are expanded.
    if depth > _MAX_DEPTH or table.position in seen:
        raise _DamagedError("its values are nested too deeply")
    seen.add(table.position)
    type = table.number(2, "B")
    if type == _ARROW_UNION and table.table(3).number(0, "h") != _DENSE:
        raise _DamagedError("a sparse union")
    children = tuple(_read_field(child, seen, depth + 1) for child in table.tables(5))
    return _Field(table.text(0), type, _number_type(type, table, 3), children)


def _read_layout(header: _Table) -> _Layout:
    """Return the layout of an array of numbers in the body of its message, without checking it against the body."""
    dtype = _number_type(header.number(0, "B"), header, 1)
    if dtype is None:
        raise _DamagedError("an array that does not hold numbers")
    shape = tuple(dimension.number(0, "q") for dimension in header.tables(2))
    strides = header.numbers(3)
    if strides and len(strides) != len(shape):
        raise _DamagedError(f"{len(strides)} strides of {len(shape)} dimensions")
    return _Layout(dtype, shape, strides or None, header.number(4, "q"))


def _number_type(type: int, table: _Table, slot: int) -> np.dtype | None:
    """Return the numpy type of numbers that a field of the table describes, None for other types."""
    if type == _ARROW_FLOAT:
        return _FLOATS.get(table.table(slot).number(0, "h"))
    if type == _ARROW_INT:
        described = table.table(slot)
        return _INTS.get((described.number(0, "i"), described.number(1, "B")))
    return None


def _unpack(format: str, data: bytes, position: int) -> tuple[int, ...]:
    if not 0 <= position <= len(data) - struct.calcsize(format):
        raise _DamagedError(f"an offset to {position}, outside of {len(data)} bytes of metadata")
    return struct.unpack_from(format, data, position)
