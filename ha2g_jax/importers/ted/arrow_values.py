"""Reader of values serialized by `pyarrow.serialize` of pyarrow 0.14, which no current pyarrow reads.

It uses neither pyarrow nor pickle.

The layout, little-endian:

    int32 x 3     number of tensors, arrays (numpy) and buffers; only arrays are read here
    padding to 8 bytes
    an Arrow stream: the message of a schema, that of a record batch, int32 0
    padding to 64 bytes, then each array: its message, whose body is the numbers, and padding to 64 bytes

The batch has one column, a dense union, whose only row is the value. A union has a child for each kind of Python value
in it; the name of the child is the number of the kind. A list is a row of a list array over a union, which has the
items of all lists at that level; a dict is a row of a list array over a struct of two unions, keys and values. A null
row of a union is None. An array is an index into the arrays at the end. Objects of other types are dicts with the key
"_pytype_", mostly pickled.
"""

import math
import struct
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.importers.ted import arrow_metadata as arrow
from ha2g_jax.importers.ted.arrow_metadata import DamagedError, Field, Table

# Kinds of Python values.
_BOOL, _BYTES, _STRING, _LIST, _DICT, _TUPLE, _ARRAY = 0, 3, 4, 9, 10, 11, 14
_NUMBERS = {1: np.dtype("<i8"), 2: np.dtype("<i8"), 5: np.dtype("<f2"), 6: np.dtype("<f4"), 7: np.dtype("<f8")}
_INDEX = np.dtype("<i4")
_PICKLED = "_pytype_"

# Functions that return the Python values of some rows of an Arrow array, and of a range of rows of a union.
_Rows: TypeAlias = Callable[[np.ndarray], Sequence[Any]]
_Range: TypeAlias = Callable[[int, int], list[Any]]


class _OtherTypeError(Exception):
    """Error for a value that only pyarrow or pickle can read."""


def deserialize(data: bytes, name: str) -> Any:
    """Deserialize a value that `pyarrow.serialize(value).to_buffer()` of pyarrow 0.14 has serialized.

    Args:
        data: bytes of the value.
        name: name of the data in an error message.

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
    except (DamagedError, ValueError, IndexError, TypeError, OverflowError) as error:
        reason = " ".join(str(error).split())
        raise UserError(f"{name} is damaged or not of pyarrow 0.14 ({reason}); copy or download it again") from error


def _read(data: bytes) -> Any:
    if len(data) < 16:
        raise DamagedError(f"{len(data)} bytes are too few")
    num_tensors, num_arrays, num_buffers = struct.unpack_from("<iii", data)
    metadata, start = arrow.split_message(data, 16)
    fields = arrow.read_schema(arrow.read_message(metadata, arrow.SCHEMA).header)
    metadata, start = arrow.split_message(data, start)
    batch = arrow.read_message(metadata, arrow.RECORD_BATCH)
    end = _end(data, start, batch.body_length)
    if num_tensors or num_buffers:
        raise _OtherTypeError("tensors or buffers of pyarrow")
    if len(fields) != 1:
        raise DamagedError(f"{len(fields)} columns")
    arrays = _read_arrays(data, _aligned(end + 4), num_arrays)
    value = _Batch(memoryview(data)[start:end], batch.header, arrays, len(data)).union(fields[0])
    return value(0, 1)[0]


def _read_arrays(data: bytes, position: int, count: int) -> list[np.ndarray]:
    arrays: list[np.ndarray] = []
    # Thousands of arrays of one shape have the same metadata.
    layouts: dict[bytes, tuple[arrow.Layout, int]] = {}
    for _ in range(count):
        metadata, start = arrow.split_message(data, position)
        if metadata not in layouts:
            layouts[metadata] = _read_layout(metadata)
        layout, length = layouts[metadata]
        end = _end(data, start, length)
        arrays.append(np.ndarray(layout.shape, layout.dtype, data, start + layout.offset, layout.strides))
        position = _aligned(end)
    return arrays


def _read_layout(metadata: bytes) -> tuple[arrow.Layout, int]:
    """Return the layout of an array, checked to lie inside the body of its message, and the length of the body."""
    message = arrow.read_message(metadata, arrow.TENSOR)
    layout = arrow.read_layout(message.header)
    size, itemsize = math.prod(layout.shape), layout.dtype.itemsize
    last = sum((count - 1) * stride for count, stride in zip(layout.shape, layout.strides or ()))
    # The first term refuses overlapping rows, with which an array could be larger than its bytes; none is written so.
    needed = layout.offset + (max(size * itemsize, last + itemsize) if size else 0)
    if min(0, *layout.shape, *(layout.strides or ()), layout.offset) < 0 or needed > message.body_length:
        raise DamagedError(f"an array of shape {layout.shape} in {message.body_length} bytes")
    return layout, message.body_length


class _Batch:
    """Reader of the arrays of a record batch, which must be read in the order in which they are stored."""

    def __init__(self, body: memoryview, header: Table, arrays: list[np.ndarray], budget: int):
        self._body, self._arrays = body, arrays
        self._nodes, self._buffers = iter(header.pairs(1)), iter(header.pairs(2))
        # Bytes of values that may still be made, because rows that are used repeatedly could exceed the memory.
        self._budget = budget

    def union(self, field: Field) -> _Range:
        if field.type != arrow.UNION:
            raise DamagedError(f"an array of type {field.type} instead of a union")
        length, num_nulls = self._node()
        bitmap = self._bytes()
        kinds, rows = self._buffer(np.dtype("i1"), length), self._buffer(np.dtype("<u4"), length)
        is_valid = _bits(bitmap, length) if num_nulls else np.ones(length, bool)
        children = [self._child(child) for child in field.children]

        def values(start: int, end: int) -> list[Any]:
            if not 0 <= start <= end <= length:
                raise DamagedError(f"items {start} to {end} of {length}")
            self._spend(end - start)
            values: list[Any] = [None] * (end - start)
            own_kinds, own_rows = kinds[start:end], rows[start:end]
            for kind in set(own_kinds[is_valid[start:end]].tolist()):
                if not 0 <= kind < len(children):
                    raise DamagedError(f"child {kind} of {len(children)}")
                places = np.flatnonzero(is_valid[start:end] & (own_kinds == kind))
                for place, value in zip(places.tolist(), children[kind](own_rows[places]), strict=True):
                    values[place] = value
            return values

        return values

    def _child(self, field: Field) -> _Rows:
        kind = int(field.name)
        length, _ = self._node()
        self._bytes()  # the bitmap of nulls: only unions have some
        if kind == _BOOL and field.type == arrow.BOOL:
            bits = _bits(self._bytes(), length)
            return lambda rows: bits[rows].tolist()
        if kind in _NUMBERS and field.dtype == _NUMBERS[kind]:
            numbers = self._buffer(_NUMBERS[kind], length)
            return lambda rows: numbers[rows].tolist()
        if kind == _ARRAY and field.dtype == _INDEX:
            indices = self._buffer(_INDEX, length)
            return lambda rows: [self._array(index) for index in indices[rows].tolist()]
        if (kind, field.type) in ((_STRING, arrow.TEXT), (_BYTES, arrow.BINARY)):
            return self._texts(kind, self._buffer(_INDEX, length + 1))
        if kind in (_LIST, _TUPLE, _DICT) and field.type == arrow.LIST and len(field.children) == 1:
            return self._containers(kind, self._buffer(_INDEX, length + 1), field.children[0])
        raise _OtherTypeError(f"Python objects of kind {kind} as Arrow type {field.type}")

    def _texts(self, kind: int, ends: np.ndarray) -> _Rows:
        text = self._bytes()

        def values(rows: np.ndarray) -> list[str] | list[bytes]:
            texts: list[bytes] = []
            for start, end in _ranges(ends, rows):
                if not 0 <= start <= end <= len(text):
                    raise DamagedError(f"a text from {start} to {end} in {len(text)} bytes")
                self._spend(end - start)
                texts.append(bytes(text[start:end]))
            return [text.decode() for text in texts] if kind == _STRING else texts

        return values

    def _containers(self, kind: int, ends: np.ndarray, items: Field) -> _Rows:
        if kind != _DICT:
            container, union = list if kind == _LIST else tuple, self.union(items)
            return lambda rows: [container(union(start, end)) for start, end in _ranges(ends, rows)]
        if items.type != arrow.STRUCT or len(items.children) != 2:
            raise DamagedError("a dict without keys and values")
        self._node()
        self._bytes()
        keys, values = (self.union(child) for child in items.children)
        return lambda rows: [_make_dict(keys(*span), values(*span)) for span in _ranges(ends, rows)]

    def _array(self, index: int) -> np.ndarray:
        if not 0 <= index < len(self._arrays):
            raise DamagedError(f"array {index} of {len(self._arrays)}")
        self._spend(self._arrays[index].nbytes)
        return self._arrays[index]

    def _spend(self, size: int) -> None:
        self._budget -= size
        if self._budget < 0:
            raise DamagedError("its values are larger than itself")

    def _node(self) -> tuple[int, int]:
        length, num_nulls = next(self._nodes, (-1, -1))
        if length < 0:
            raise DamagedError("arrays are missing")
        return length, num_nulls

    def _buffer(self, dtype: np.dtype, length: int) -> np.ndarray:
        buffer = self._bytes()
        if length * dtype.itemsize > len(buffer):
            raise DamagedError(f"{length} items of {dtype.itemsize} bytes in {len(buffer)} bytes")
        return np.frombuffer(buffer[: length * dtype.itemsize], dtype)

    def _bytes(self) -> memoryview:
        offset, length = next(self._buffers, (-1, -1))
        if offset < 0 or length < 0 or offset + length > len(self._body):
            raise DamagedError(f"bytes {offset} to {offset + length} of {len(self._body)}")
        return self._body[offset : offset + length]


def _bits(bitmap: memoryview, length: int) -> np.ndarray:
    if length > 8 * len(bitmap):
        raise DamagedError(f"{length} bits in {len(bitmap)} bytes")
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
        raise DamagedError(f"it ends after {len(data)} bytes, not {start + length}")
    return start + length


def _aligned(position: int) -> int:
    return -(-position // 64) * 64
