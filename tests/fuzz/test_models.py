"""Models and archives of PyTorch from elsewhere are loaded or refused in one line, before they are traced or read.

No test runs a network, and shapes of equal networks are traced once.
"""

import argparse
import collections
import functools
import hashlib
import json
import pathlib
import shutil
import struct

import numpy as np
import pytest
import safetensors.numpy
from fuzz.mutation import FUZZ, damaged_bytes, damaged_tree
from hypothesis import given
from hypothesis import strategies as st

from ha2g_jax.checkpoint import model_folder
from ha2g_jax.checkpoint import whisper as whisper_weights
from ha2g_jax.checkpoint.released.importing import import_weights
from ha2g_jax.errors import UserError
from ha2g_jax.files.torch_archive import read_torch
from ha2g_jax.limits import MAX_ASSETS_BYTES, MAX_CONFIG_BYTES, MAX_HEADER_BYTES, MAX_WEIGHTS_BYTES

CONFIG, ASSETS, WEIGHTS = "config.json", "assets.json", "model.safetensors"


@pytest.fixture(scope="module", autouse=True)
def traced_once():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(whisper_weights, "_parameters", functools.cache(whisper_weights._parameters))
        yield


@pytest.fixture(scope="module")
def content(debug_model, tmp_path_factory):
    """The content of each file of a model folder, by name."""
    folder = tmp_path_factory.mktemp("models") / "debug"
    model_folder.save(folder, debug_model.config, debug_model.assets, debug_model.variables)
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture
def folder(content, tmp_path):
    """A model folder that a test may damage."""
    for name, data in content.items():
        (tmp_path / name).write_bytes(data)
    return tmp_path


def load(path: pathlib.Path) -> None:
    """Load the folder of a file."""
    model_folder.load(path.parent)


def load_with_hash(path: pathlib.Path) -> None:
    """Load the folder of weights after its assets were given their hash, as by who wants them to be read."""
    assets = json.loads((path.parent / ASSETS).read_text())
    assets["hash"] = hashlib.sha256(path.read_bytes()).hexdigest()[:16]
    (path.parent / ASSETS).write_text(json.dumps(assets))
    load(path)


def header_of(data: bytes) -> tuple[dict, bytes]:
    """Return the header of a file of safetensors, and the tensors after it."""
    size = 8 + struct.unpack("<Q", data[:8])[0]
    return json.loads(data[8:size]), data[size:]


def with_header(header: object, tensors: bytes) -> bytes:
    text = json.dumps(header).encode()
    return struct.pack("<Q", len(text)) + text + tensors


@FUZZ
@given(data=st.data())
@pytest.mark.parametrize("name", [CONFIG, ASSETS])
def test_descriptions(answered, content, folder, name, data):
    values = data.draw(damaged_tree(json.loads(content[name])))
    answered(load, json.dumps(values).encode(), name)


@FUZZ
@given(data=st.data())
def test_numbers_of_a_config(answered, content, folder, data):
    """Every number may have any value; the others fit."""
    values = json.loads(content[CONFIG])
    part = values[data.draw(st.sampled_from(["data", "model"]))]
    key = data.draw(st.sampled_from(sorted(part)))
    while isinstance(part[key], dict):
        part = part[key]
        key = data.draw(st.sampled_from(sorted(part)))
    numbers = st.sampled_from(
        [0, -1, 1, 2, 3, 5, 16, 17, 34, 2**31, 10**9, 10**30, 0.5, -0.5, float("nan"), True, None]
    )
    part[key] = data.draw(
        numbers | st.lists(numbers, max_size=5) | st.sampled_from(["", "speakers", "none", "waveform"])
    )
    answered(load, json.dumps(values).encode(), CONFIG)


@FUZZ
@given(data=st.data())
def test_headers_of_weights(answered, content, folder, data):
    header, tensors = header_of(content[WEIGHTS])
    answered(load_with_hash, with_header(data.draw(damaged_tree(header)), tensors), WEIGHTS)


@FUZZ
@given(data=st.data())
def test_bytes_of_weights(answered, content, folder, data):
    size = 8 + struct.unpack("<Q", content[WEIGHTS][:8])[0]
    start = data.draw(damaged_bytes(content[WEIGHTS][: data.draw(st.sampled_from([16, 200, size]))]))
    answered(load_with_hash, start + content[WEIGHTS][size:], WEIGHTS)


WHISPER = {"model_type": "whisper", "activation_function": "gelu", "num_mel_bins": 6, "d_model": 8}
WHISPER |= {"encoder_layers": 1, "encoder_attention_heads": 2, "encoder_ffn_dim": 20}


@pytest.fixture(scope="module")
def whisper(tmp_path_factory):
    """The folder of a tiny Whisper encoder."""
    folder = tmp_path_factory.mktemp("whisper")
    (folder / CONFIG).write_text(json.dumps(WHISPER))
    shapes = whisper_weights._parameters(whisper_weights.read_sizes(folder))
    tensors = {
        f"model.encoder.{whisper_weights._their_name(name)}": np.ones(shape[::-1], np.float32)
        for name, shape in shapes.items()
    }
    safetensors.numpy.save_file(tensors, folder / WEIGHTS)
    whisper_weights.load(folder)
    return folder


@FUZZ
@given(data=st.data())
def test_whisper_folders(answered, whisper, tmp_path, data):
    shutil.copytree(whisper, tmp_path, dirs_exist_ok=True)
    name, damaged = CONFIG, json.dumps(data.draw(damaged_tree(WHISPER))).encode()
    if data.draw(st.booleans()):
        name, (header, tensors) = WEIGHTS, header_of((whisper / WEIGHTS).read_bytes())
        damaged = with_header(data.draw(damaged_tree(header)), tensors)
    answered(lambda path: whisper_weights.load(path.parent), damaged, name)


@pytest.mark.parametrize(
    ("setting", "value"),
    [
        ("model.inferer.layers", 10**6),
        ("model.audio.resnet_se.channels", [8, 8, 17, 32]),
        ("model.audio", None),
        ("data.fps", 10**400),
        ("model.audio.levels", ["x" * 10_000]),
        ("method", {"ha2g": 1}),
    ],
)
def test_sizes_that_cannot_work_are_named(folder, refused, setting, value):
    values = json.loads((folder / CONFIG).read_text())
    *path, last = setting.split(".")
    functools.reduce(lambda part, key: part[key], path, values)[last] = value
    (folder / CONFIG).write_text(json.dumps(values))
    assert CONFIG in refused("export-model", str(folder), str(folder / "out"))


@pytest.mark.parametrize(("name", "most"), [(CONFIG, MAX_CONFIG_BYTES), (ASSETS, MAX_ASSETS_BYTES)])
def test_a_large_file_is_not_read(folder, refused, name, most):
    with (folder / name).open("r+b") as file:
        file.truncate(2**40)
    assert f"more than {most} bytes" in refused("export-model", str(folder), str(folder / "out"))


def test_large_weights_are_not_read(folder, content):
    with (folder / WEIGHTS).open("r+b") as file:
        file.write(struct.pack("<Q", MAX_HEADER_BYTES + 1))
    with pytest.raises(UserError, match="its header has more than"):
        model_folder.load(folder)
    header, tensors = header_of(content[WEIGHTS])
    end = max(entry["data_offsets"][1] for entry in header.values())
    header["padding"] = {"dtype": "U8", "shape": [2**33], "data_offsets": [end, end + 2**33]}
    (folder / WEIGHTS).write_bytes(with_header(header, tensors))
    with (folder / WEIGHTS).open("r+b") as file:
        file.truncate(file.seek(0, 2) + 2**33)
    with pytest.raises(UserError, match=f"more than {MAX_WEIGHTS_BYTES} bytes"):
        model_folder.load(folder)


@pytest.mark.parametrize(("value", "message"), [(np.float32("nan"), "not finite"), (np.int32(1), "as I32, expected")])
def test_weights_that_are_no_numbers_are_refused(folder, value, message):
    tensors = safetensors.numpy.load_file(folder / WEIGHTS)
    name = max(tensors, key=lambda name: tensors[name].size)
    tensors[name] = np.full(tensors[name].shape, value)
    (folder / WEIGHTS).unlink()
    safetensors.numpy.save_file(tensors, folder / WEIGHTS)
    with pytest.raises(UserError, match=message):
        load_with_hash(folder / WEIGHTS)


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
