"""Bytes of arrays and of nested values in a record, whose stated sizes are checked before anything is built."""

import math
from typing import Any

import msgpack
import numpy as np

from ha2g_jax.limits import MAX_CLIP_BYTES

_FLOATS = ("<f4", "<f8")
# A list or dict takes up to a hundred times its bytes in memory. The greatest clip needs half of these.
_MAX_LENGTH = 250_000  # elements of one list
_MAX_VALUES = 1_000_000  # elements of all lists and dicts of a record


def pack_array(array: np.ndarray) -> dict[str, Any]:
    """Return an array as a dict for msgpack: float64 as such, everything else as float32.

    Args:
        array: array of any shape.
    """
    floats = "<f8" if array.dtype == np.float64 else "<f4"
    packed = {"shape": list(array.shape), "data": np.ascontiguousarray(array, floats).tobytes()}
    return packed if floats == "<f4" else {"dtype": floats, **packed}


def unpack_array(packed: Any) -> np.ndarray:
    """Return the array of a dict that `pack_array` has made, float32 or float64.

    Args:
        packed: value from a file.

    Raises:
        TypeError, ValueError: it is no such dict, or its shape does not fit its bytes.
    """
    if not isinstance(packed, dict):
        raise TypeError(f"{type(packed).__name__} in place of an array")
    floats, shape, data = packed.get("dtype", "<f4"), packed.get("shape"), packed.get("data")
    if floats not in _FLOATS:
        raise ValueError(f"numbers of type {repr(floats)[:20]}")
    if not isinstance(shape, list) or len(shape) > 4 or not all(type(size) is int and size >= 0 for size in shape):
        raise ValueError(f"an array of shape {repr(shape)[:60]}")
    num_bytes = math.prod(shape) * np.dtype(floats).itemsize
    if not isinstance(data, bytes) or len(data) != num_bytes:
        found = f"{len(data)} bytes" if isinstance(data, bytes) else type(data).__name__
        raise ValueError(f"an array of shape {shape} in {found} instead of {num_bytes} bytes")
    return np.frombuffer(data, floats).reshape(shape).copy()


def unpack_values(record: bytes) -> dict[str, Any]:
    """Unpack a record of msgpack of limited size.

    Args:
        record: bytes from a file.

    Raises:
        TypeError, ValueError, msgpack.UnpackException: the bytes are not msgpack, no dict, or have too many values.
    """
    if len(record) > MAX_CLIP_BYTES:
        raise ValueError(f"{len(record)} bytes, expected {MAX_CLIP_BYTES} at most")
    count = 0

    def counted(value: Any) -> Any:
        nonlocal count
        count += len(value) + 1
        if count > _MAX_VALUES:
            raise ValueError(f"more than {_MAX_VALUES} values")
        return value

    values = msgpack.unpackb(
        record,
        list_hook=counted,
        object_hook=counted,
        max_array_len=min(_MAX_LENGTH, len(record)),
        max_map_len=min(_MAX_LENGTH, len(record)),
    )
    if not isinstance(values, dict):
        raise TypeError(f"{type(values).__name__} in place of fields")
    return values
