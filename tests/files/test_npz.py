"""Arrays from untrusted files: numpy's files are read, and all others give one line of error."""

import io
import struct
import tracemalloc
import zipfile

import numpy as np
import pytest
from fuzz.conftest import one_line
from fuzz.mutation import FUZZ, damaged_bytes
from hypothesis import given
from hypothesis import strategies as st

from ha2g_jax.errors import UserError
from ha2g_jax.files.npz import read_npz

ARRAYS = {
    "poses": np.arange(12, dtype=np.float32).reshape(3, 4),
    "fortran": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
    "big_endian": np.array([1, 2], ">i4"),
    "gender": np.array("neutral"),
    "rate": np.array(30),
    "seen": np.array([True, False]),
    "none": np.zeros((0, 3), np.float32),
    "names": np.array(["é", "bc"]),
}


def _npz(save=np.savez, **arrays) -> bytes:
    file = io.BytesIO()
    save(file, **arrays)
    return file.getvalue()


def _npy(array: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def _zip(entries: dict[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", method) as archive:
        for name, content in entries.items():
            archive.writestr(name, content)
    return file.getvalue()


def _header(text: str, data: bytes = b"") -> bytes:
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text.encode() + data


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_reads_what_numpy_wrote(tmp_path, save):
    (tmp_path / "a.npz").write_bytes(_npz(save, **ARRAYS))
    arrays = read_npz(tmp_path / "a.npz")
    assert list(arrays) == list(ARRAYS)
    for name, array in ARRAYS.items():
        np.testing.assert_array_equal(arrays[name], array, strict=name != "big_endian")
        assert arrays[name].flags.writeable
        assert arrays[name].dtype.isnative


def test_a_npy_is_an_array_under_its_stem(tmp_path):
    np.save(tmp_path / "joints.npy", ARRAYS["poses"])
    np.testing.assert_array_equal(read_npz(tmp_path / "joints.npy")["joints"], ARRAYS["poses"])
    assert read_npz(tmp_path / "joints.npy", names=["other"]) == {}


def test_arrays_that_are_not_asked_for_are_not_judged(tmp_path):
    (tmp_path / "a.npz").write_bytes(_npz(poses=ARRAYS["poses"], parts=np.array({"arm": 1})))
    assert list(read_npz(tmp_path / "a.npz", names=["poses", "missing"])) == ["poses"]
    with pytest.raises(UserError, match="array 'parts': it holds Python objects"):
        read_npz(tmp_path / "a.npz")


def _encrypted() -> bytes:
    content = bytearray(_npz(a=np.ones(3)))
    for at in (content.find(b"PK\x03\x04") + 6, content.find(b"PK\x01\x02") + 8):
        content[at] |= 1
    return bytes(content)


def _declaring(num_bytes: int) -> bytes:
    """An archive whose table of contents claims that its only array unpacks to `num_bytes`."""
    content = bytearray(_zip({"a.npy": _header("{'descr': '<f8', 'fortran_order': False, 'shape': (9999999,), }\n")}))
    struct.pack_into("<I", content, content.find(b"PK\x01\x02") + 24, num_bytes)
    return bytes(content)


def _huge_contents() -> bytes:
    content = bytearray(_npz(a=np.ones(3)) + b"\0" * (3 << 20))
    end = content.find(b"PK\x05\x06")
    content += content[end : end + 22]
    del content[end : end + 22]
    struct.pack_into("<I", content, len(content) - 22 + 12, 3 << 20)
    return bytes(content)


F4 = "{'descr': '<f4', 'fortran_order': False, 'shape': %s, }\n"
BAD = {
    "nothing": (b"", "is an empty file"),
    "broken middle": (_npz(a=np.ones(99)).replace(np.float64(1).tobytes(), b"\x01" * 8), "not a whole .npz file"),
    "objects": (_npz(a=np.array([{}, 1])), "Python objects"),
    "text of no length": (_zip({"a.npy": _header(F4.replace("<f4", "<U0") % "(9,)")}), "elements of type"),
    "many elements": (_zip({"a.npy": _header(F4 % "(1000000000, 1000000000)")}), "needs 4000000000000000000 bytes"),
    "few elements": (_zip({"a.npy": _header(F4 % "(2,)", b"\0" * 12)}), "needs 8 bytes, but it has 12"),
    "huge header": (_zip({"a.npy": b"\x93NUMPY\x02\x00\xff\xff\xff\x7f"}), "a header of 2147483647 bytes"),
    "bomb": (_declaring(300 << 20), "unpack to 314572800, more than 200 times as many"),
    "greater bomb": (_declaring(0xF0000000), "more than the 1073741824 allowed"),
    "huge contents": (_huge_contents(), "table of contents of 3145728 bytes"),
    "encrypted": (_encrypted(), "is encrypted"),
    "nested": (_zip({"../a.npy": _npy(np.ones(3))}), "not an array"),
    "odd compression": (_zip({"a.npy": _npy(np.ones(3))}, zipfile.ZIP_LZMA), "a method that numpy does not use"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_files_are_refused_in_one_line_and_little_memory(tmp_path, name):
    content, message = BAD[name]
    path = tmp_path / "bad.npz"
    path.write_bytes(content)
    tracemalloc.start()
    try:
        with pytest.raises(UserError, match=message) as error:
            read_npz(path)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)
    assert peak < (8 << 20)


def test_missing_files_folders_and_double_names_are_refused(tmp_path):
    with pytest.raises(UserError, match="no file at"):
        read_npz(tmp_path / "missing.npz")
    with pytest.raises(UserError, match="is a directory"):
        read_npz(tmp_path)
    (tmp_path / "loop.npz").symlink_to("loop.npz")
    with pytest.raises(UserError, match=r"cannot read .*too many levels of symbolic links"):
        read_npz(tmp_path / "loop.npz")
    with pytest.warns(UserWarning, match="Duplicate"), zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("a.npy", _npy(np.ones(3)))
        archive.writestr("a.npy", _npy(np.ones(3)))
    with pytest.raises(UserError, match="twice"):
        read_npz(tmp_path / "a.npz")


def test_the_limit_holds_for_all_arrays_together_and_for_a_single_one(tmp_path):
    np.savez(tmp_path / "a.npz", a=np.ones(100), b=np.ones(100))
    assert len(read_npz(tmp_path / "a.npz", max_bytes=2000)) == 2
    assert len(read_npz(tmp_path / "a.npz", max_bytes=1000, names=["a"])) == 1
    with pytest.raises(UserError, match="more than the 1000 allowed"):
        read_npz(tmp_path / "a.npz", max_bytes=1000)
    np.save(tmp_path / "a.npy", np.ones(200))
    with pytest.raises(UserError, match="more than the 1000 allowed"):
        read_npz(tmp_path / "a.npy", max_bytes=1000)


WHOLE = [_npz(np.savez_compressed, **ARRAYS), _npz(**ARRAYS), _npy(ARRAYS["poses"])]


@FUZZ
@given(content=st.sampled_from(WHOLE).flatmap(damaged_bytes) | st.binary(max_size=300))
def test_any_bytes_are_read_or_refused(tmp_path, content):
    path = tmp_path / "fuzz.npz"
    path.write_bytes(content)
    with one_line():
        arrays = read_npz(path, max_bytes=1 << 20)
        assert sum(array.nbytes for array in arrays.values()) <= 1 << 20
        assert not any(array.dtype.hasobject for array in arrays.values())
