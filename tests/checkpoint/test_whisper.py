"""Whisper folders of Hugging Face are read in all their forms; other folders are refused in one line."""

import json

import jax
import ml_dtypes
import numpy as np
import pytest
import safetensors.numpy

from ha2g_jax.checkpoint import whisper as whisper_weights
from ha2g_jax.errors import UserError
from ha2g_jax.layers.whisper import WhisperEncoder, sinusoids

CONFIG = {
    "model_type": "whisper",
    "activation_function": "gelu",
    "d_model": 8,
    "num_mel_bins": 6,
    "encoder_layers": 2,
    "encoder_attention_heads": 2,
    "encoder_ffn_dim": 20,
    "decoder_layers": 3,
}


def make_tensors() -> dict[str, np.ndarray]:
    """Return random tensors of a whole model, exact in bfloat16; those of the decoder are not finite."""
    shapes = {"conv1.weight": (8, 6, 3), "conv2.weight": (8, 8, 3), "conv1.bias": (8,), "conv2.bias": (8,)}
    shapes |= {"layer_norm.weight": (8,), "layer_norm.bias": (8,)}
    for layer in ("layers.0.", "layers.1."):
        shapes |= {f"{layer}self_attn.{name}_proj.weight": (8, 8) for name in ("q", "k", "v", "out")}
        shapes |= {f"{layer}self_attn.{name}_proj.bias": (8,) for name in ("q", "v", "out")}
        shapes |= {f"{layer}{name}.weight": (8,) for name in ("self_attn_layer_norm", "final_layer_norm")}
        shapes |= {f"{layer}{name}.bias": (8,) for name in ("self_attn_layer_norm", "final_layer_norm")}
        shapes |= {f"{layer}fc1.weight": (20, 8), f"{layer}fc1.bias": (20,)}
        shapes |= {f"{layer}fc2.weight": (8, 20), f"{layer}fc2.bias": (8,)}
    rng = np.random.default_rng(0)
    tensors = {f"model.encoder.{name}": rng.integers(-128, 128, shape) / 64 for name, shape in shapes.items()}
    tensors["model.encoder.embed_positions.weight"] = sinusoids(1500, 8)
    tensors["model.decoder.embed_tokens.weight"] = np.full((4, 8), np.nan)
    return tensors


def write(folder, tensors, dtype: type = np.float32, config=CONFIG):
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "config.json").write_text(json.dumps(config))
    arrays = {name: np.ascontiguousarray(tensor, dtype) for name, tensor in tensors.items()}
    safetensors.numpy.save_file(arrays, folder / "model.safetensors")
    return folder


@pytest.fixture(scope="module")
def tensors():
    return make_tensors()


@pytest.fixture
def folder(tensors, tmp_path):
    return write(tmp_path / "whisper", tensors)


def assert_are(params, tensors, prefix="model.encoder."):
    """Check that each parameter has its place and Linen's order of axes."""
    for ours, theirs in (("conv_1", "conv1"), ("conv_2", "conv2")):
        # (outputs, inputs, taps) to (taps, inputs, outputs)
        np.testing.assert_array_equal(params[ours]["kernel"], tensors[f"{prefix}{theirs}.weight"].transpose(2, 1, 0))
        np.testing.assert_array_equal(params[ours]["bias"], tensors[f"{prefix}{theirs}.bias"])
    np.testing.assert_array_equal(params["norm"]["scale"], tensors[f"{prefix}layer_norm.weight"])
    np.testing.assert_array_equal(params["norm"]["bias"], tensors[f"{prefix}layer_norm.bias"])
    for index in range(2):
        block, layer = params[f"block_{index}"], f"{prefix}layers.{index}."
        for ours, theirs in (("query", "q"), ("key", "k"), ("value", "v"), ("out", "out")):
            name = f"{layer}self_attn.{theirs}_proj"
            np.testing.assert_array_equal(block["attention"][ours]["kernel"], tensors[f"{name}.weight"].T)
            if ours != "key":
                np.testing.assert_array_equal(block["attention"][ours]["bias"], tensors[f"{name}.bias"])
        for ours, theirs in (("expand", "fc1"), ("contract", "fc2")):
            np.testing.assert_array_equal(block[ours]["kernel"], tensors[f"{layer}{theirs}.weight"].T)
            np.testing.assert_array_equal(block[ours]["bias"], tensors[f"{layer}{theirs}.bias"])
        for ours, theirs in (("attention_norm", "self_attn_layer_norm"), ("mlp_norm", "final_layer_norm")):
            np.testing.assert_array_equal(block[ours]["scale"], tensors[f"{layer}{theirs}.weight"])
            np.testing.assert_array_equal(block[ours]["bias"], tensors[f"{layer}{theirs}.bias"])


@pytest.mark.parametrize("dtype", [np.float32, np.float16, ml_dtypes.bfloat16])
def test_all_weights_find_their_place(tensors, tmp_path, dtype):
    """The tensors of the decoder, which are NaN here, are not read."""
    sizes, params = whisper_weights.load(write(tmp_path, tensors, dtype))
    assert sizes == (6, 8, 2, 2, 20)
    assert {leaf.dtype for leaf in jax.tree.leaves(params)} == {np.dtype(np.float32)}
    assert_are(params, tensors)
    encoder = WhisperEncoder(**sizes._asdict())
    wanted = jax.eval_shape(lambda: encoder.init(jax.random.key(0), np.zeros((1, 6, 4), np.float32)))
    assert jax.tree.map(lambda leaf: leaf.shape, params) == jax.tree.map(lambda leaf: leaf.shape, wanted["params"])


def test_names_without_prefix_and_without_a_decoder(tensors, tmp_path):
    short = {name.removeprefix("model."): tensor for name, tensor in tensors.items() if "encoder" in name}
    del short["encoder.embed_positions.weight"]
    assert_are(whisper_weights.load(write(tmp_path, short))[1], short, "encoder.")


def shard(folder, tensors):
    """Write the first half of the encoder, the other half, and the decoder as files beside an index."""
    (folder / "model.safetensors").unlink()
    encoder = [name for name in tensors if "encoder" in name]
    parts = {"a.safetensors": encoder[::2], "b.safetensors": encoder[1::2]}
    for name, members in parts.items():
        arrays = {member: np.ascontiguousarray(tensors[member], np.float32) for member in members}
        safetensors.numpy.save_file(arrays, folder / name)
    places = {member: name for name, members in parts.items() for member in members}
    places["model.decoder.embed_tokens.weight"] = "c.safetensors"
    (folder / "model.safetensors.index.json").write_text(json.dumps({"weight_map": places}))


def test_shards(folder, tensors):
    """The shard of the decoder does not exist."""
    shard(folder, tensors)
    assert_are(whisper_weights.load(folder)[1], tensors)
    (folder / "b.safetensors").unlink()
    refused(folder, r"no file .*b\.safetensors; download")


def refused(folder, message):
    with pytest.raises(UserError, match=message) as caught:
        whisper_weights.load(folder)
    assert "\n" not in str(caught.value) and str(folder) in str(caught.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"model_type": "wav2vec2"}, "model_type 'wav2vec2'; expected a Whisper model"),
        ({"encoder_attention_heads": 3}, "d_model 8 and 3 encoder_attention_heads"),
        ({"encoder_layers": 3}, r"no tensor model\.encoder\.layers\.2\..*config\.json asks for"),
    ],
)
def test_configs_that_do_not_fit(folder, change, message):
    (folder / "config.json").write_text(json.dumps(CONFIG | change))
    refused(folder, message)


def test_files_that_are_damaged_or_missing(folder, tmp_path):
    weights = folder / "model.safetensors"
    data = weights.read_bytes()
    for size in (0, 4, 100, -1):
        weights.write_bytes(data[:size])
        refused(folder, r"model\.safetensors is (damaged \(.+\); |an empty file: copy or )download it again")
    weights.rename(folder / "pytorch_model.bin")
    refused(folder, r"no model\.safetensors in ")
    for text in ("{", "[]", "\x00"):
        (folder / "config.json").write_text(text)
        refused(folder, "config.json is damaged")
    refused(tmp_path / "nowhere", r"no file .*config\.json; expected a folder with config\.json and model\.safetensors")


def test_a_damaged_index(folder, tensors):
    shard(folder, tensors)
    index = {"weight_map": {"model.encoder.conv1.weight": "../a.safetensors"}}
    (folder / "model.safetensors.index.json").write_text(json.dumps(index))
    refused(folder, "has no weight_map from tensors to files beside it")


def test_tensors_that_do_not_fit(tensors, tmp_path):
    name, positions = "model.encoder.layers.1.fc2.weight", "model.encoder.embed_positions.weight"
    for changed, value, message in (
        (name, None, rf"no tensor {name}"),
        (name, np.zeros((20, 8)), r"fc2\.weight of shape \(20, 8\), expected \(8, 20\)"),
        (name, np.full((8, 20), np.inf), r"fc2\.weight that are not finite"),
        (positions, tensors[positions] + 0.1, "not Whisper's sinusoids"),  # trained
    ):
        others = {key: tensor for key, tensor in tensors.items() if key != changed}
        refused(write(tmp_path, others if value is None else others | {changed: value}), message)
    encoder = {name: tensor for name, tensor in tensors.items() if "encoder" in name}
    refused(write(tmp_path, encoder, np.int8), r"as I8, expected one of F32, F16, BF16")
