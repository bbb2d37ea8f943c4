"""Damaged databases are named in one line, whatever LMDB does with them; work is done in order and in bounds."""

import pathlib
import random
import struct
from collections.abc import Callable

import lmdb
import pytest
from fixtures.ted_files import write_database
from fuzz.conftest import one_line
from fuzz.mutation import FUZZ, damaged_bytes
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ha2g_jax.data import processes
from ha2g_jax.errors import UserError
from ha2g_jax.importers.ted import importer

PAGE = 4096
VALUES = [b"first", b"x" * 5 * PAGE, b"third"]


@pytest.fixture
def database(tmp_path: pathlib.Path) -> pathlib.Path:
    """Three records; the second has pages of its own."""
    folder = tmp_path / "lmdb"
    folder.mkdir()
    return write_database(folder, VALUES)


def read_all(folder: pathlib.Path) -> list[bytes]:
    return [importer.read_value(folder, key) for key in importer.read_keys(folder)]


def test_reads_what_lmdb_wrote(database: pathlib.Path):
    assert importer.check_whole(database) == 3
    assert importer.read_keys(database) == [b"0000000000", b"0000000001", b"0000000002"]
    assert read_all(database) == VALUES
    assert sorted(path.name for path in database.iterdir()) == ["data.mdb"]


def test_the_newer_of_the_two_meta_pages_counts(database: pathlib.Path):
    with lmdb.open(str(database), map_size=1 << 26, lock=False) as environment:
        for number in range(3, 6):
            with environment.begin(write=True) as transaction:
                transaction.put(f"{number:010d}".encode(), b"y" * 3 * PAGE)
            assert importer.check_whole(database) == number + 1


def damage(database: pathlib.Path, change: Callable[[bytes], bytes]) -> None:
    path = database / "data.mdb"
    path.write_bytes(change(path.read_bytes()))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda data: b"", r"data.mdb \(0 bytes\) is not an LMDB database"),
        (lambda data: data[:-1], r"data.mdb has \d+ bytes instead of \d+; copy or download it again"),
        # The last page that the meta pages name.
        (lambda data: data.replace(struct.pack("<Q", len(data) // PAGE - 1), b"\xff" * 7 + b"\0"), "instead of"),
    ],
)
def test_files_that_are_not_whole_are_refused(database: pathlib.Path, change: Callable[[bytes], bytes], message: str):
    damage(database, change)
    with pytest.raises(UserError, match=message):
        importer.check_whole(database)


def test_pages_that_name_each_other_end(database: pathlib.Path):
    # The leaf with the keys: two nodes are made one and the same.
    damage(database, lambda data: data.replace(b"0000000002", b"0000000000"))
    with pytest.raises(UserError, match="keys out of order"):
        importer.read_keys(database)


def test_values_longer_than_the_file_are_refused(database: pathlib.Path):
    """The length of a value lies before its key: two halves around the flags."""
    old, size = 5 * PAGE, 2**31 - 1
    new = struct.pack("<HH", size & 0xFFFF, size >> 16)
    damage(
        database,
        lambda data: data.replace(
            struct.pack("<HHHH", old, 0, 1, 10) + b"0000000001", new + b"\1\0\n\x00" + b"0000000001"
        ),
    )
    with processes.workers(1) as executor, pytest.raises(UserError, match="damaged"):
        list(processes.in_order(executor, read_all, [(database,)], 1, "FILE is damaged"))


@FUZZ
@given(data=st.data())
def test_any_meta_pages(database: pathlib.Path, tmp_path: pathlib.Path, data: st.DataObject):
    content = (database / "data.mdb").read_bytes()
    (tmp_path / "data.mdb").write_bytes(data.draw(damaged_bytes(content[: 2 * PAGE])) + content[2 * PAGE :])
    with one_line():
        importer.check_whole(tmp_path)


@settings(max_examples=3, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 2**32))
def test_any_pages(database: pathlib.Path, tmp_path: pathlib.Path, seed: int):
    """Whatever LMDB makes of damaged pages, the parent has the values or a line about the file."""
    rng, data = random.Random(seed), bytearray((database / "data.mdb").read_bytes())
    for page in range(2, len(data) // PAGE):
        for _ in range(rng.randrange(4)):
            data[page * PAGE + rng.randrange(rng.choice((24, PAGE)))] = rng.choice((0, 1, 127, 255))
    (tmp_path / "data.mdb").write_bytes(data)
    importer.check_whole(tmp_path)
    with processes.workers(1) as executor:
        try:
            [values] = processes.in_order(executor, read_all, [(tmp_path,)], 1, str(tmp_path / "data.mdb"))
            assert all(isinstance(value, bytes) for value in values)
        except UserError as error:
            assert str(tmp_path / "data.mdb") in str(error)
            assert "\n" not in str(error)
