"""The reader of pyarrow 0.14 reads what that wrote, unpickles nothing, and survives any bytes."""

import base64
import tracemalloc
import zlib
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ha2g_jax.errors import UserError
from ha2g_jax.importers.ted.arrow import deserialize

Serialize = Callable[[Any], bytes]

ARRAYS = [np.arange(6, dtype=np.float32).reshape(2, 3), np.arange(6.0).reshape(2, 3), np.zeros((0, 3))]
# Written by pyarrow 0.14.1: the values of `test_reads_pyarrow_0_14`, the second array column by column.
GENUINE = """
    eNrFWC9sU0EYv/de270tj5eKhryQJZRkYgLRhRFGskAFYmIJExMTCCCQlGQkS5hoCKICMTFRgahAVCAqJyYQE0swFYiJCuTExARiYmLA1vLd3ffa
    6+/d279scNm1/e73u+/ffXfv9oQQwhOD9iUnRF79GhOByIms8OkXNccjWZDk02eGP2mYv3/+6vVICpd4foxF1D//UVh/TLbx32osKAJf6s0TNqvx
    8DArxDTj0o8tklepl6lH1A8IaFOvUBAdV4hl4sxKHccDm2NsU+p3OV45TtMpQiFG2O4o9U1t1x2n3wHzZNtX48Ipso4pcmqXY1h0kzF0JKbjvjFJ
    eIFxOXfL0Zwj4kxoTth0knnrHCfztqj5QcVJ2pwjbJVtzjrDNneYs0x4g21uiqTNuZOkzTbb/CCSNrcI22d9CxZ9DYu+SMflRZDj92rcVbwHPP5m
    9fXbeO0eGnX6TOsI5y02g27S5rrmZwtg8wONS860odu0q9a6NMA6p9j9aLGbObHbPTyn3Sd6flCz5H6GsFcaDxct/hR6SX8+ndjru32i67vM3Cmb
    PzTYYX/mLfUndRyyP0Wovz2556m3DJ9cY1/e1bkLNi1xFgmb13i4xnri+XIdJhRPnlb6dLLpX++mrH93sA4bXXtu9rqn5yauzYOU+RO9880v6dx4
    6GOxp328L/e/5mSQ84Q596hXe/ZYK71BrJ/ZljzPCgZHqCzm1Llo7sXvmu9OAF/m3acT1OdUmzHmiSl1jSgv8vxccXKRsca67jP99S6l5EaOLb95
    t9rf/yPaD6FivMlPqkBZEp6n6n87Lnp6AkSEZPhZFmS1fcfYe09FevNTvvPAywMegVwEXnyszMTrA/oqMH8F8BXAq4BXAa8BXgN8DeQ68OuAN0Bu
    Ar8JeAvwFuAbgG8A/hXkbeBvA94GvA34DuA7gP8AeRf4u4DvA74P+AHIR8A/Ajwu0H7dgZwHOXKG9UWAFwEvAj4JeJoc80sgzwB/BvAyyHPAnwN8
    AeQl4C8B/hzwNDnmV0BeAf4K4FWQa8CvAb4Gch34dcAbgDcAb4LcAn4L8A3AY9k8t+7AOSgs8g0YP4t/1bJ7zfy0+f8r3n8te+J8TdZB93Zfi+tl
    srkRf3R0VFysOZYc078QqvGNoBz7Vfn2xe73I1gvJz1GG+4CtwqYc4rvaXk0x1+cEX/a+MtLzKMdX8a8nrcdC/MedWv4HpXx1J0lGpoRikl13wvU
    /S7kElrne6XJjSCngfF/jjleYswnjT6/Wwgsdemr+6TG89ZYzburc4Es1B7LxxP9Ua9Rb5avMn+lS+avBHmy3TuvL38XraRBHdJN5zF7GueRvwtl
    W/7i902h+b6Jclc4JV8fLfkSKfnyYXy6n6/hfHjWu//w+66rydOg/QWsCkg9
"""
# Written by pyarrow 0.14.1: {"x": np.array([1, "a"], dtype=object)}.
PICKLED = """
    eNq9lCFs20AUhu8uSRtVXmVp1RRQMFBQNDnSQCYNFBQEVGrAwECl1lIqrVI3WZ3BIg0EBgwEDAQMDAYGDBQGDAQUFAwUFgwEDBQUFKzx3t09J87v
    XKeq057k2P/7f9/3YvksxHz9LAjhm6sV4YklURJluqKSBdKCVJl+i/xLbT4PficJqdUvfH/qVegYW2/a03Vpe14T8nrdH9q7Nf6jGvlr7CvNUTZz
    Q5kNm1n9rPLMvds885XteXsqz6yTFzMzUPPM79JmjsnvMbMv5zPbdKzr2TNcxVzNOLf9kr7H4/t0Damv/ed0XPN82zI/35i8tYllVxzsxmQxe2ey
    mP1yMmNHNuN9E3l2k7wusztiMfvMwR452KcZ9i+bURuZtYVhe3Qsmxn0clu8ZpUzR/Hh25TzAnp6hmp19l43Ejv/jsi/K50k/660k8VzR8ls7rRy
    3GDmjZj7hlkpI+D/t8Q7Cvk+PYkyucuG7vOelKVKZn7LLk7v+9tMund89D7WvU9F+6yF+X9PeKd7hiYKBTPrzXS1FdKe2fX6W7DOe1ZmeIFwV9lx
    9iHng18B36XT/FPQm5DfBD8AXYN8Dfwt0HXI18FvgO/Saf416APIH8BzikC3Id+G9Tqgu5Dvgt8Dvwf+V9B9yPfBH4A/AP8U9BDyQ/BH4I/APwd9
    AfkL8C9BjyE/Bv8KtK7HsC/Ef9DqgVr+Y/++2lXyjv6HO+5zzVfkb7muZhiH+1ErbkWH+y6YukdfwnUI+Y+789/Dd9Gz8OQkbIkH1h/w8LWa
"""

FUZZ = settings(
    max_examples=50, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


def unpack(text: str) -> bytes:
    return zlib.decompress(base64.b64decode("".join(text.split())))


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
    assert_equal(deserialize(unpack(GENUINE), "FILE"), expected)


def test_never_unpickles(serialize: Serialize):
    with pytest.raises(UserError, match=r"FILE holds an object of type 'np.array', which is never unpacked"):
        deserialize(unpack(PICKLED), "FILE")
    with pytest.raises(UserError, match="never unpacked"):
        deserialize(serialize([{"_pytype_": "os.system", "pickle": True, "data": b"cos\nsystem\n."}]), "FILE")


values = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**63 - 1) | st.floats(allow_nan=False) | st.text() | st.binary(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=3), inner, max_size=4),
    max_leaves=20,
)


@FUZZ
@given(value=values)
def test_round_trip(serialize: Serialize, value: Any):
    assert_equal(deserialize(serialize(value), "FILE"), value)


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64, np.int64, np.uint8])
def test_arrays_keep_type_and_order(serialize: Serialize, dtype: type):
    array = np.arange(24).reshape(2, 3, 4).astype(dtype)
    value = [array, np.asfortranarray(array), np.array(7, dtype)]
    assert_equal(deserialize(serialize(value), "FILE"), value)


def test_every_cut_is_noticed():
    data = unpack(GENUINE)
    needed = len(data.rstrip(b"\0"))
    assert not any(read_or_refuse(data[:length]) for length in range(needed))


@pytest.mark.parametrize(("number", "width"), [(2**31 - 1, 4), (2**32 - 1, 4), (2**62, 8)])
def test_huge_declared_lengths_take_no_memory(serialize: Serialize, number: int, width: int):
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


def test_rows_used_again_and_again_are_refused(serialize: Serialize):
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
