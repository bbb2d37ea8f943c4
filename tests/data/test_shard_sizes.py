"""A shard whose records would take too much memory is refused before anything is unpacked."""

import os

import numpy as np
import pytest
from array_record.python import array_record_module  # pyright: ignore[reportAttributeAccessIssue]

from ha2g_jax.data import corpus
from ha2g_jax.data.corpus import check_sizes
from ha2g_jax.errors import UserError
from ha2g_jax.limits import MAX_CLIP_BYTES


def write(path, records, options="group_size:1"):
    writer = array_record_module.ArrayRecordWriter(str(path), options)
    for record in records:
        writer.write(record)
    writer.close()
    return path


@pytest.mark.parametrize("options", ["group_size:1", "group_size:1,zstd:3", "group_size:1,uncompressed"])
def test_sizes_are_those_of_the_records(tmp_path, options):
    random = np.random.default_rng(0)
    sizes = random.integers(0, 200_000, 40).tolist()  # many begin in one block and end in another
    path = write(tmp_path / "x", (random.bytes(size) for size in sizes), options)
    with path.open("rb") as file:
        found = list(corpus._unpacked_sizes(file))
    assert [size for size in found if size in sizes] == sizes


def test_a_record_that_unpacks_to_more_than_the_limit_is_refused(tmp_path):
    path = write(tmp_path / "x", [b"small", bytes(MAX_CLIP_BYTES + 1), b"small"])
    assert path.stat().st_size < MAX_CLIP_BYTES / 100
    with pytest.raises(UserError, match=f"unpacks to {MAX_CLIP_BYTES + 1} bytes"):
        check_sizes(path)


def test_damaged_headers_are_left_to_the_reader(tmp_path):
    path = write(tmp_path / "x", [os.urandom(1000)] * 5)
    whole = path.read_bytes()
    for number in range(0, 8000, 7):
        path.write_bytes(whole[:number] + b"\xff" * 8 + whole[number + 8 :])
        try:
            check_sizes(path)
        except UserError as error:
            assert "unpacks to" in str(error)  # the damage is in the stated size
