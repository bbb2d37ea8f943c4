"""Read the encoder of a Whisper model from CTranslate2's model.bin and write it in the form of Hugging Face.

The format (version 6, little-endian): a version, the name and revision of the model, the number of variables; for each
the name, shape, type and bytes; then aliases, other names for a variable. A string is its length with a closing 0,
uint16, and its bytes. Quantised values are the true ones times a scale, of each row or of the whole variable.
"""

import json
import pathlib
import re
import struct

import ml_dtypes
import numpy as np
import safetensors.numpy

_VERSION = 6
_TYPES = (np.float32, np.int8, np.int16, np.int32, np.float16, ml_dtypes.bfloat16)
_BLOCK = {
    "self_attention/layer_norm": "self_attn_layer_norm",
    "self_attention/linear_1": "self_attn.out_proj",
    "ffn/layer_norm": "final_layer_norm",
    "ffn/linear_0": "fc1",
    "ffn/linear_1": "fc2",
}
_KINDS = {"gamma": "weight", "beta": "bias", "weight": "weight", "bias": "bias"}


def read_variables(path: pathlib.Path) -> dict[str, np.ndarray]:
    """Return all variables of a model.bin as they are stored, aliases under both names."""
    with path.open("rb") as file:

        def number(form: str) -> int:
            return struct.unpack(f"<{form}", file.read(struct.calcsize(f"<{form}")))[0]

        def string() -> str:
            return file.read(number("H"))[:-1].decode()

        version, name = number("I"), string()
        if (version, name) != (_VERSION, "WhisperSpec"):
            raise ValueError(f"{path} is a {name} of version {version}, expected a WhisperSpec of {_VERSION}")
        number("I")  # revision
        variables = {}
        for _ in range(number("I")):
            name = string()
            shape = tuple(number("I") for _ in range(number("B")))
            dtype = np.dtype(_TYPES[number("B")])
            variables[name] = np.frombuffer(file.read(number("I")), dtype).reshape(shape)
        for _ in range(number("I")):
            alias = string()
            variables[alias] = variables[string()]
        if file.read(1):
            raise ValueError(f"{path} goes on after its last variable")
    return variables


def dequantize(variables: dict[str, np.ndarray], name: str) -> np.ndarray:
    """Return a variable as float32."""
    values = variables[name].astype(np.float32)
    scale = np.asarray(variables.get(f"{name}_scale", 1), np.float32)
    return values / scale.reshape(scale.shape + (1,) * (values.ndim - scale.ndim))


def encoder_tensors(variables: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the weights of the encoder as float32, by their names in `transformers`."""
    tensors = {"model.encoder.embed_positions.weight": dequantize(variables, "encoder/position_encodings/encodings")}

    def add(ours: str, theirs: str) -> None:
        for kind, name in _KINDS.items():
            if f"{theirs}/{kind}" in variables:
                tensors[f"model.encoder.{ours}.{name}"] = dequantize(variables, f"{theirs}/{kind}")

    for ours, theirs in (("conv1", "conv1"), ("conv2", "conv2"), ("layer_norm", "layer_norm")):
        add(ours, f"encoder/{theirs}")
    for index in range(num_layers(variables)):
        for theirs, ours in _BLOCK.items():
            add(f"layers.{index}.{ours}", f"encoder/layer_{index}/{theirs}")
        fused = f"encoder/layer_{index}/self_attention/linear_0"  # queries, keys and values, one below the other
        for kind in ("weight", "bias"):
            parts = np.split(dequantize(variables, f"{fused}/{kind}"), 3)
            for name, part in zip("qkv", parts, strict=True):
                tensors[f"model.encoder.layers.{index}.self_attn.{name}_proj.{kind}"] = part
        key_bias = tensors.pop(f"model.encoder.layers.{index}.self_attn.k_proj.bias")
        if np.any(key_bias):
            raise ValueError("keys have a bias, which Whisper's have not")
    return tensors


def num_layers(variables: dict[str, np.ndarray]) -> int:
    """Return the number of blocks of the encoder."""
    return len({name.split("/")[1] for name in variables if re.match(r"encoder/layer_\d+/", name)})


def write_folder(model: pathlib.Path, folder: pathlib.Path, dtype: type = np.float32) -> None:
    """Write the encoder of a CTranslate2 folder as a Hugging Face folder."""
    variables = read_variables(model / "model.bin")
    tensors = encoder_tensors(variables)
    d_model, num_mels, _ = tensors["model.encoder.conv1.weight"].shape
    config = {
        "model_type": "whisper",
        "activation_function": "gelu",
        "architectures": ["WhisperForConditionalGeneration"],
        "d_model": d_model,
        "num_mel_bins": num_mels,
        "encoder_layers": num_layers(variables),
        "encoder_attention_heads": int(variables["encoder/num_heads"]),
        "encoder_ffn_dim": len(tensors["model.encoder.layers.0.fc1.bias"]),
        "max_source_positions": len(tensors["model.encoder.embed_positions.weight"]),
    }
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "config.json").write_text(json.dumps(config, indent=2) + "\n")
    tensors = {name: np.ascontiguousarray(tensor, dtype) for name, tensor in tensors.items()}
    safetensors.numpy.save_file(tensors, folder / "model.safetensors", metadata={"format": "pt"})
