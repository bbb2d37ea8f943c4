"""Archives of PyTorch are read without it, and those that lie or ask for more are refused with nothing run."""

import argparse
import collections
import os
import pickle
import tracemalloc
import zipfile

import numpy as np
import pytest

from ha2g_jax import limits
from ha2g_jax.errors import UserError
from ha2g_jax.files import torch_archive
from ha2g_jax.files.torch_archive import Inert, read_torch

NUMBERS = np.arange(12, dtype=np.float32).reshape(3, 4)


class Settings:
    """An object of a class that only its writer knows."""

    rate = 0.0


class Call:
    """Asks to be made by a call, as a malicious pickle does."""

    def __init__(self, function, *arguments):
        self.call = function, arguments

    def __reduce__(self):
        return self.call


@pytest.fixture
def refused(tmp_path):
    """A function from an archive to the one line that refuses it."""

    def refused(archive, **settings):
        with pytest.raises(UserError) as error:
            read_torch(archive.save(tmp_path / "bad.bin", **settings))
        message = str(error.value)
        assert "bad.bin" in message and len(message.splitlines()) == 1 and len(message) < 400
        return message

    return refused


def test_values_and_tensors_come_back(torch_files, tmp_path):
    tensor, settings = torch_files.Tensor, Settings()
    settings.rate = 0.5
    value = {
        "state": collections.OrderedDict(weight=tensor(NUMBERS), count=tensor(np.array(3))),
        "part": tensor(NUMBERS, offset=1, shape=(4, 2), strides=(1, 4)),
        "half": tensor(NUMBERS.astype(np.float16)),
        "args": argparse.Namespace(numbers=[[0.5], [1.5]], none=None, yes=True, large=1 << 40),
        "settings": settings,
        "vectors": np.ones(3),
        "counts": [collections.Counter(a=2), collections.defaultdict(list, b=[1]), {3}],
        "epoch": 7,
    }
    found = read_torch(torch_files.Archive(value).save(tmp_path / "good.bin"))
    np.testing.assert_array_equal(found["state"]["weight"], NUMBERS)
    assert found["state"]["count"].shape == () and found["state"]["count"] == 3
    np.testing.assert_array_equal(found["part"], NUMBERS.ravel()[1:9].reshape(2, 4).T)
    assert found["half"].dtype == np.float16 and found["epoch"] == 7
    args = {"numbers": [[0.5], [1.5]], "none": None, "yes": True, "large": 1 << 40}
    assert found["args"] == Inert("argparse.Namespace", args)
    assert found["settings"].name.endswith("Settings") and found["settings"].state == {"rate": 0.5}
    assert isinstance(found["vectors"], Inert)
    assert found["counts"] == [{"a": 2}, {"b": [1]}, [3]]


@pytest.mark.parametrize("where", ["value", "state of an object", "list"])
def test_nothing_is_called(where, torch_files, refused, tmp_path):
    evil = Call(os.mkdir, str(tmp_path / "made"))
    value = {"value": evil, "state of an object": argparse.Namespace(x=evil), "list": [1, evil]}[where]
    assert "asks to call posix.mkdir, which is never done" in refused(torch_files.Archive({"gen_dict": value}))
    assert not (tmp_path / "made").exists()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"\x80\x02cposix\nmkdir\nX\x01\x00\x00\x00a\x85\x81.", "asks to make posix.mkdir with arguments"),
        (b"(S'a'\niposix\nmkdir\n.", "the opcode STRING"),
        (b"\x80\x02(X\x01\x00\x00\x00aiposix\nmkdir\n.", "the opcode INST"),
        (b"\x80\x02(cposix\nmkdir\nX\x01\x00\x00\x00ao.", "the opcode OBJ"),
        (b"\x80\x02\x82\x01.", "the opcode EXT1"),
        (b"\x80\x04cposix\nmkdir\n)}\x92.", "the opcode NEWOBJ_EX"),
        (b"\x80\x02}X\x01\x00\x00\x00acposix\nmkdir\ns.", "refers to posix.mkdir"),
        (b"\x80\x02c__builtin__\neval\nX\x01\x00\x00\x001\x85R.", "asks to call __builtin__.eval"),
        (b"\x80\x02}K\x01\x85K\x02s.", "keys other than text"),
        (b"\x80\x02u.", "damaged"),
        (b"\x80\x02X\xff\xff\xff\x7fabc.", "damaged"),
    ],
)
def test_a_pickle_that_asks_for_more_or_is_damaged(content, message, torch_files, refused):
    archive = torch_files.Archive({})
    archive.files["archive/data.pkl"] = content
    assert message in refused(archive)


@pytest.mark.parametrize(
    ("lies", "message"),
    [
        ({"count": 1 << 40}, "and not 4 times 1099511627776"),
        ({"shape": (4, 4)}, "a tensor of shape (4, 4) in 12 numbers"),
        ({"shape": (1 << 40, 1 << 40), "strides": (0, 0)}, "in 12 numbers"),
        ({"strides": (-4, 1)}, "an impossible shape"),
        ({"offset": -1}, "an impossible shape"),
    ],
)
def test_a_tensor_that_lies_about_its_size(lies, message, torch_files, refused):
    assert message in refused(torch_files.Archive({"x": torch_files.Tensor(NUMBERS, **lies)}))


@pytest.mark.parametrize("name", ["../evil", "/etc/evil", "archive\\..\\evil", "C:evil"])
def test_a_name_that_leads_out_of_the_archive(name, torch_files, refused, tmp_path):
    archive = torch_files.Archive({})
    archive.files[name] = b"x"
    assert "leads out of it" in refused(archive)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bad.bin"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda files: files.pop("archive/data/0"), "the numbers '0' are missing"),
        (lambda files: files.update({"archive/data/0": b"short"}), "take 5 bytes"),
        (lambda files: files.update({"archive/constants.pkl": b""}), "TorchScript"),
    ],
)
def test_an_archive_without_its_files(change, message, torch_files, refused):
    archive = torch_files.Archive({"x": torch_files.Tensor(NUMBERS)})
    change(archive.files)
    assert message in refused(archive)


def test_a_compressed_archive_cannot_fill_the_memory(torch_files, refused):
    archive = torch_files.Archive({"x": torch_files.Tensor(np.zeros(1 << 16, np.float32))})
    assert "compressed" in refused(archive, compression=zipfile.ZIP_DEFLATED)


def test_a_file_that_ends_early_or_has_another_content(torch_files, tmp_path):
    content = torch_files.Archive({"x": torch_files.Tensor(NUMBERS)}).save(tmp_path / "whole.bin").read_bytes()
    damaged = content.replace(NUMBERS.tobytes(), NUMBERS.tobytes()[::-1])
    assert damaged != content
    for data in [*(content[:size] for size in range(0, len(content), 40)), damaged, b"", pickle.dumps({}), b"text"]:
        (tmp_path / "part.bin").write_bytes(data)
        with pytest.raises(UserError, match=r"part\.bin is (not an archive of weights of PyTorch|an empty file)"):
            read_torch(tmp_path / "part.bin")
    with pytest.raises(UserError, match="cannot read"):
        read_torch(tmp_path / "absent.bin")


def test_a_file_beyond_the_limits(torch_files, refused, monkeypatch):
    archive = torch_files.Archive({str(number): number for number in range(100)})
    monkeypatch.setattr(torch_archive, "MAX_TORCH_OPCODES", 200)
    assert "more than 200 opcodes" in refused(archive)
    for index in range(limits.MAX_TORCH_FILES):
        archive.files[f"archive/data/{index}"] = b""
    assert "8002 files" in refused(archive)


def test_numbers_stay_in_the_file_until_they_are_used(torch_files, tmp_path):
    value = {name: torch_files.Tensor(np.full((1 << 20, 4), 0.5, np.float32)) for name in "ab"}
    path = torch_files.Archive(value).save(tmp_path / "large.bin")
    tracemalloc.start()
    found = read_torch(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert path.stat().st_size > 1 << 25 and peak < 1 << 21
    assert found["b"].sum() == 2 << 20 and not found["a"].flags.writeable


def test_a_file_that_is_larger_than_any_archive_is_not_read(tmp_path):
    with (tmp_path / "best.bin").open("wb") as file:
        file.truncate(limits.MAX_TORCH_BYTES + 1)
    with pytest.raises(UserError, match=f"expected at most {limits.MAX_TORCH_BYTES}"):
        read_torch(tmp_path / "best.bin")


@pytest.mark.parametrize("place", [26, 28])
def test_a_header_that_leads_to_other_numbers(place, torch_files, tmp_path):
    """Before each file of a zip file are the lengths of its name and of an extra field, which say where it begins."""
    path = torch_files.Archive({"x": torch_files.Tensor(NUMBERS)}).save(tmp_path / "bad.bin")
    content = path.read_bytes()
    start = content.index(b"archive/data/0") - 30
    for length in (1, 255):
        path.write_bytes(content[: start + place] + bytes([length]) + content[start + place + 1 :])
        with pytest.raises(UserError, match=r"bad checksum|ends early"):
            read_torch(path)


def test_a_value_that_grows_when_it_is_followed_does_not_fill_the_memory(torch_files, tmp_path):
    value = ["x"]
    for _ in range(60):
        value = [value, value]
    assert read_torch(torch_files.Archive(value).save(tmp_path / "many.bin"))
