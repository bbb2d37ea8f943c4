"""ONNX files: the description of the model in their metadata, and reading of untrusted files.

Only graphs of the kind that `export` writes reach a runtime. Nothing here imports JAX.
"""

import json
import pathlib
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

from ha2g_jax.checkpoint import assets as assets_module
from ha2g_jax.checkpoint.assets import Assets
from ha2g_jax.checkpoint.onnx import bounds
from ha2g_jax.errors import require
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.features.spectrum import FFT_SIZE, FLOOR_DB, HOP_LENGTH, NUM_MELS, window_columns
from ha2g_jax.files.reading import check_regular, parse_json, read_bytes, reading, reason
from ha2g_jax.limits import (
    MAX_CHANNELS,
    MAX_MODEL_FPS,
    MAX_ONNX_BYTES,
    MAX_ONNX_METADATA_BYTES,
    MAX_WINDOW_FRAMES,
    MIN_MODEL_FPS,
    MIN_WINDOW_FRAMES,
)
from ha2g_jax.motion.windows import window_stride

if TYPE_CHECKING:
    import onnx

SUFFIX = ".onnx"
OUTPUT = "poses"
FEATURES = ("f_low", "f_mid", "f_high")

BY = "an ONNX file"  # what needs the packages of the extra onnx

_EXPECTED = "an ONNX file of ha2g model onnx"
# None of them contains a graph, so that there are no loops, and none reads a file.
_OPERATORS = (
    *("Add", "BatchNormalization", "Cast", "Concat", "Conv", "DepthToSpace", "DequantizeLinear", "Div", "Flatten"),
    *("GRU", "Gather", "GlobalAveragePool", "MatMul", "Max", "Mul", "Pad", "ReduceSum", "Relu", "Reshape", "Sigmoid"),
    *("Slice", "Softmax", "Sqrt", "Sub", "Transpose", "Unsqueeze"),
)
_DOMAINS = ("", "ai.onnx")
_ATTRIBUTES = (1, 2, 3, 7)  # a number, a text or integers: FLOAT, INT, STRING, INTS of `onnx.AttributeProto`

FORMAT = "ha2g-jax 1"
MAX_TEXT = 200  # characters of a text of the metadata
_NUMBERS = ("num_frames", "num_seed_frames", "fps", "style_dim")
_TEXTS = ("name", "method", "weights", "license")


class Description(NamedTuple):
    """A model without its networks."""

    name: str
    method: str  # "ha2g" or "energy_ha2g"
    num_frames: int
    num_seed_frames: int
    fps: int
    style_dim: int
    has_hidden_ends: bool  # whether the model was trained with hidden ends, `config.data.lookahead` > 0
    weights: str  # form of the weights in the file, see `networks.WEIGHTS`
    license: str
    assets: Assets  # without a vocabulary
    noise_dim: int = 0  # channels of the noise, of a model that samples

    @property
    def window_stride(self) -> int:
        """Number of frames from the start of one window of a recording to the start of the next."""
        return window_stride(self.num_frames, self.num_seed_frames)


def input_names(description: Description) -> tuple[str, ...]:
    """Return the names of the inputs of a graph in their order."""
    return ("mel", "style", "seed_pose", "noise")[: 4 if description.noise_dim else 3]


def to_metadata(description: Description) -> dict[str, str]:
    """Return a description as texts by name, for `metadata_props`; all but plain texts are JSON."""
    assets, skeleton = assets_module.to_json(description.assets), description.assets.skeleton
    audio = {
        "sample_rate": SAMPLE_RATE,
        "fft_size": FFT_SIZE,
        "hop_length": HOP_LENGTH,
        "num_mels": NUM_MELS,
        "columns": window_columns(description.num_frames, description.fps),
        "floor_db": FLOOR_DB,
    }
    values = {
        **{name: getattr(description, name) for name in _NUMBERS},
        "has_hidden_ends": description.has_hidden_ends,
        "audio": audio,
        "skeleton": assets["skeleton"] | {"joints": skeleton.joints, "bones": skeleton.bones},
        "speakers": assets["speakers"],
        "seed_poses": assets["seed_poses"],
    }
    if description.noise_dim:
        values["noise_dim"] = description.noise_dim
    texts = {"format": FORMAT, "hash": description.assets.hash}
    texts |= {name: getattr(description, name) for name in _TEXTS}
    return texts | {name: json.dumps(value) for name, value in values.items()}


def from_metadata(metadata: Mapping[str, str]) -> Description:
    """Return the description that `to_metadata` wrote, from untrusted texts.

    Raises:
        KeyError, TypeError, ValueError, OverflowError: the texts are not a description.
    """
    if metadata.get("format") != FORMAT:
        raise ValueError("not written by ha2g model onnx, or of another version")
    if sum(map(len, metadata.values())) > MAX_ONNX_METADATA_BYTES:
        raise ValueError(f"more than {MAX_ONNX_METADATA_BYTES} characters of metadata")
    texts: dict[str, Any] = {name: metadata[name] for name in _TEXTS}
    if any(len(text) > MAX_TEXT or not text.isprintable() for text in texts.values()):
        raise ValueError("a text of the metadata is too long or cannot be printed")
    values: dict[str, Any] = {
        name: parse_json(metadata[name])
        for name in (*_NUMBERS, "has_hidden_ends", "skeleton", "speakers", "seed_poses")
    }
    numbers = {name: values[name] for name in _NUMBERS} | {"noise_dim": parse_json(metadata.get("noise_dim", "0"))}
    if any(type(number) is not int for number in numbers.values()):
        raise TypeError("a size is not a whole number")
    ranges = {
        "num_frames": (MIN_WINDOW_FRAMES, MAX_WINDOW_FRAMES),
        "num_seed_frames": (1, numbers["num_frames"] // 2),
        "fps": (MIN_MODEL_FPS, MAX_MODEL_FPS),
        "style_dim": (0, MAX_CHANNELS),
        "noise_dim": (0, MAX_CHANNELS),
    }
    for name, (least, most) in ranges.items():
        if not least <= numbers[name] <= most:
            raise ValueError(f"{name} is {numbers[name]} instead of {least} to {most}")
    assets = assets_module.from_json(
        {name: values[name] for name in ("skeleton", "speakers", "seed_poses")}
        | {"schema_version": assets_module.SCHEMA_VERSION, "vocabulary": [], "hash": metadata["hash"]}
    )
    assets_module.check_fit(assets, numbers["num_seed_frames"], numbers["style_dim"])
    hidden = values["has_hidden_ends"]
    return Description(**texts, **numbers, has_hidden_ends=hidden is True, assets=assets)


class Parts(NamedTuple):
    """A graph in two parts, so that the speech of a window can be encoded while the previous window is sampled."""

    encoder: bytes  # ONNX from "mel" to f_low, f_mid and f_high
    sampler: bytes  # ONNX from f_low, f_mid, f_high, "style", "seed_pose" and "noise", if there is any, to "poses"


def read(path: str | pathlib.Path) -> tuple[Description, Parts]:
    """Read a model from a file that `export` wrote.

    Raises:
        UserError: the file is missing, damaged or not of the kind that `export` writes, or the package onnx is missing.
    """
    require("onnx", "onnx", by=BY)
    from google.protobuf.message import DecodeError
    from onnx.shape_inference import InferenceError
    from onnx.utils import Extractor

    path = pathlib.Path(path)
    check_regular(path, _EXPECTED)
    with reading(path, _EXPECTED, DecodeError, InferenceError, LookupError):
        description, model = parse(read_bytes(path, _EXPECTED, MAX_ONNX_BYTES))
        extractor = Extractor(model)
        features = list[str](FEATURES)
        encoder = extractor.extract_model(["mel"], features).SerializeToString()
        sampler = extractor.extract_model([*features, *input_names(description)[1:]], [OUTPUT]).SerializeToString()
        return description, Parts(encoder, sampler)


def parse(content: bytes) -> "tuple[Description, onnx.ModelProto]":
    """Parse and check the content of an untrusted file.

    Raises:
        ValueError, LookupError, DecodeError, InferenceError: it is not of the kind that `export` writes, or too large.
    """
    import onnx

    bounds.check_bytes(content)
    model = onnx.load_model_from_string(content)
    try:
        description = from_metadata({it.key: it.value for it in model.metadata_props})
    except KeyError as error:
        raise ValueError(f"{reason(error)} is missing in the metadata") from error
    except (TypeError, AttributeError) as error:
        raise ValueError(reason(error)) from error
    _check_graph(model)
    _check_ends(model.graph, description)
    bounds.check_cost(model)
    return description, model


def _check_graph(model: "onnx.ModelProto") -> None:
    """Check that a graph is self-contained: no code, no other files, no graph in a graph."""
    graph = model.graph
    if model.functions or any(it.domain not in _DOMAINS for it in model.opset_import):
        raise ValueError("functions, or operators that are not of ONNX")
    if graph.sparse_initializer or graph.quantization_annotation:
        raise ValueError("sparse or annotated weights")
    for node in graph.node:
        if node.domain not in _DOMAINS or node.op_type not in _OPERATORS:
            raise ValueError(f"the operator {node.op_type[:50]!r}, which no model of HA2G has")
        if any(attribute.type not in _ATTRIBUTES for attribute in node.attribute):
            raise ValueError(f"an attribute of {node.op_type}, which no model of HA2G has")
    if any(tensor.external_data or tensor.data_location for tensor in graph.initializer):
        raise ValueError("weights in another file")
    made = [
        *(it.name for it in (*graph.input, *graph.initializer)),
        *(name for node in graph.node for name in node.output),
    ]
    used = [name for node in graph.node for name in (node.name, *node.input)]
    if len(set(made)) < len(made) or not all(name.isascii() for name in made + used):
        raise ValueError("two values of one name, or names that are not ASCII")


def _check_ends(graph: "onnx.GraphProto", description: Description) -> None:
    """Check the inputs and the output against the description."""
    frames, bones = description.num_frames, description.assets.skeleton.num_bones
    expected = {
        "mel": (NUM_MELS, window_columns(frames, description.fps)),
        "style": (description.style_dim,),
        "seed_pose": (description.num_seed_frames, bones, 3),
        "noise": (frames, description.noise_dim),
    }
    inputs = input_names(description)
    if tuple(it.name for it in graph.input) != inputs or [it.name for it in graph.output] != [OUTPUT]:
        raise ValueError(f"its inputs and outputs are not {', '.join(inputs)} and {OUTPUT}")
    shapes = {it.name: _shape(it) for it in (*graph.input, *graph.output)}
    expected[OUTPUT] = (frames, bones, 3)
    for name in (*inputs, OUTPUT):
        if shapes[name] != (shape := expected[name]):
            raise ValueError(f"{name} has shape {shapes[name]} instead of {shape}")


def _shape(value: "onnx.ValueInfoProto") -> tuple[int, ...]:
    """Return the shape of a value without the batch axis; -1 for a size that is not fixed."""
    sizes = value.type.tensor_type.shape.dim[1:]
    return tuple(it.dim_value if it.HasField("dim_value") else -1 for it in sizes)
