"""The reader of pyarrow 0.14 reads what that wrote, unpickles nothing, and survives any bytes."""

import pathlib
import tracemalloc
from typing import Any

import numpy as np
import pytest
from fixtures.ted_files import serialize
from fuzz.mutation import FUZZ
from hypothesis import given
from hypothesis import strategies as st

from ha2g_jax.errors import UserError
from ha2g_jax.importers.ted.arrow import deserialize

# Written by pyarrow 0.14.1: the values of `test_reads_pyarrow_0_14`, the second array column by column.
GENUINE = (pathlib.Path(__file__).parent / "pyarrow_0_14_values.bin").read_bytes()
# Written by pyarrow 0.14.1: {"x": np.array([1, "a"], dtype=object)}.
PICKLED = (pathlib.Path(__file__).parent / "pyarrow_0_14_pickled.bin").read_bytes()
ARRAYS = [np.arange(6, dtype=np.float32).reshape(2, 3), np.arange(6.0).reshape(2, 3), np.zeros((0, 3))]


def assert_equal(read: Any, expected: Any) -> None:
    """Equal, of the same types at every level."""
    assert type(read) is type(expected)
    if isinstance(expected, np.ndarray):
        assert read.dtype == expected.dtype
        np.testing.assert_array_equal(read, expected)
    elif isinstance(expected, list | tuple):
        assert len(read) == len(expected)
        for pair in zip(read, expected, strict=True):
            assert_equal(*pair)
    elif isinstance(expected, dict):
        assert list(read) == list(expected)
        assert_equal(list(read.values()), list(expected.values()))
    else:
        assert read == expected


def read_or_refuse(data: bytes) -> bool:
    """Whether the bytes were read; a refusal is one line with the name."""
    try:
        deserialize(data, "FILE")
    except UserError as error:
        assert str(error).startswith("FILE ")
        assert "\n" not in str(error)
        return False
    return True


def test_reads_pyarrow_0_14():
    expected = [None, True, -5, 2.5, "hä", b"\0", 1.5, [1, [2, "x"]], (1, None), {"a": {"b": [3.0]}}, *ARRAYS]
    assert_equal(deserialize(GENUINE, "FILE"), expected)


def test_never_unpickles():
    with pytest.raises(UserError, match=r"FILE holds an object of type 'np.array', which is never unpacked"):
        deserialize(PICKLED, "FILE")
    with pytest.raises(UserError, match="never unpacked"):
        deserialize(serialize([{"_pytype_": "os.system", "pickle": True, "data": b"cos\nsystem\n."}]), "FILE")


values = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**63 - 1) | st.floats(allow_nan=False) | st.text() | st.binary(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=3), inner, max_size=4),
    max_leaves=20,
)


@FUZZ
@given(value=values)
def test_round_trip(value: Any):
    assert_equal(deserialize(serialize(value), "FILE"), value)


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64, np.int64, np.uint8])
def test_arrays_keep_type_and_order(dtype: type):
    array = np.arange(24).reshape(2, 3, 4).astype(dtype)
    value = [array, np.asfortranarray(array), np.array(7, dtype)]
    assert_equal(deserialize(serialize(value), "FILE"), value)


def test_every_cut_is_noticed():
    data = GENUINE
    needed = len(data.rstrip(b"\0"))
    assert not any(read_or_refuse(data[:length]) for length in range(needed))


@pytest.mark.parametrize(("number", "width"), [(2**31 - 1, 4), (2**32 - 1, 4), (2**62, 8)])
def test_huge_declared_lengths_take_no_memory(number: int, width: int):
    """Each length, count and offset of the value is replaced in turn."""
    data = serialize([[1, None], "text", {"key": True}, np.zeros((5, 43, 3), np.float32)])
    end = data.index(bytes(5 * 43 * 3 * 4))
    is_read = []
    tracemalloc.start()
    try:
        for place in range(0, end, 4):
            is_read.append(read_or_refuse(data[:place] + number.to_bytes(width, "little") + data[place + width :]))
        assert tracemalloc.get_traced_memory()[1] < 2 << 20
    finally:
        tracemalloc.stop()
    assert is_read.count(False) > 100


def test_rows_used_again_and_again_are_refused():
    """Lists that share their items would grow exponentially."""
    depth, width = 12, 16
    value: Any = 0
    for _ in range(depth):
        value = [value, *[[]] * (width - 1)]
    data = serialize(value)
    # All lists of a level become row 0 of the level below, the one that is not empty.
    rows = np.arange(width, dtype="<i4").tobytes()
    assert data.count(rows) >= depth - 1
    with pytest.raises(UserError, match="larger than itself"):
        deserialize(data.replace(rows, bytes(len(rows))), "FILE")
