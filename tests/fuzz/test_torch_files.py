"""Archives of PyTorch from elsewhere are read or refused in one line."""

import argparse
import collections

import numpy as np
import pytest
from fuzz.mutation import FUZZ, damaged_bytes
from hypothesis import given
from hypothesis import strategies as st

from ha2g_jax.checkpoint.released.importing import import_weights
from ha2g_jax.files.torch_archive import read_torch


@pytest.fixture(scope="module")
def archive(torch_files):
    """An archive with tensors, objects and plain values."""
    state = {f"layer.{index}.weight": torch_files.Tensor(np.ones((index, 3), np.float32)) for index in range(5)}
    settings = argparse.Namespace(rate=0.5, numbers=[[1.0]] * 5, vectors=np.ones(4))
    names = {"words": {f"word {index}": index for index in range(30)}}
    return torch_files.Archive(
        {"args": settings, "gen_dict": collections.OrderedDict(state), "pose_dim": 27, "lang_model": names}
    )


@FUZZ
@given(data=st.data())
def test_pickles(answered, torch_files, archive, tmp_path, data):
    """The pickle is damaged and the archive around it is whole."""
    damaged = object.__new__(torch_files.Archive)
    pickle = data.draw(damaged_bytes(archive.files["archive/data.pkl"]))
    damaged.files = archive.files | {"archive/data.pkl": pickle}
    answered(read_torch, damaged.save(tmp_path / "made.bin").read_bytes(), "best.bin")


@FUZZ
@given(data=st.data())
def test_archives(answered, archive, tmp_path, data):
    content = archive.save(tmp_path / "made.bin").read_bytes()
    answered(lambda path: import_weights(path, tmp_path / "out"), data.draw(damaged_bytes(content)), "best.bin")
