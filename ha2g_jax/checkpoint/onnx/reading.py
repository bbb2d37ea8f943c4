"""Reader of ONNX files of unknown origin: only graphs of the kind that `export` writes reach a runtime."""

import importlib
import pathlib
from typing import TYPE_CHECKING, NamedTuple

from ha2g_jax.checkpoint.onnx.description import Description, from_metadata
from ha2g_jax.errors import UserError
from ha2g_jax.features.spectrum import NUM_MELS, window_columns
from ha2g_jax.files.reading import check_regular, read_bytes, reading, reason
from ha2g_jax.limits import MAX_ONNX_BYTES

if TYPE_CHECKING:
    import onnx

SUFFIX = ".onnx"
INPUTS, OUTPUT = ("mel", "style", "seed_pose"), "poses"
FEATURES = ("f_low", "f_mid", "f_high")

_EXPECTED = "an ONNX file of ha2g export-onnx"
# None has a graph of its own, so that a graph ends, and none reads a file.
_OPERATORS = (
    *("Add", "BatchNormalization", "Cast", "Concat", "Conv", "DepthToSpace", "DequantizeLinear", "Div", "Flatten"),
    *("GRU", "Gather", "GlobalAveragePool", "MatMul", "Max", "Mul", "Pad", "ReduceSum", "Relu", "Reshape", "Sigmoid"),
    *("Slice", "Softmax", "Sqrt", "Sub", "Transpose", "Unsqueeze"),
)
_DOMAINS = ("", "ai.onnx")
_ATTRIBUTES = (1, 2, 3, 7)  # a number, a text or integers: FLOAT, INT, STRING, INTS of `onnx.AttributeProto`


class Parts(NamedTuple):
    """A graph in two, so that the speech of a window can be encoded while the window before is sampled.

    Attributes:
        encoder: ONNX from "mel" to f_low, f_mid and f_high.
        sampler: ONNX from f_low, f_mid, f_high, "style" and "seed_pose" to "poses".
    """

    encoder: bytes
    sampler: bytes


def check_extra(*packages: str) -> None:
    """Check that packages of the extra onnx are installed.

    Args:
        packages: "onnx" or "onnxruntime".

    Raises:
        UserError: one of them is missing, or a library that it needs.
    """
    for package in packages:
        try:
            importlib.import_module(package)
        except ImportError as error:
            why = "" if isinstance(error, ModuleNotFoundError) else f", which cannot be loaded ({reason(error)})"
            raise UserError(f"ONNX files need {package}{why}: pip install 'ha2g-jax[onnx]'") from error


def read(path: str | pathlib.Path) -> tuple[Description, Parts]:
    """Read a model.

    Args:
        path: file that `export` wrote.

    Raises:
        UserError: the file is missing, damaged or not of the kind that `export` writes, or the package onnx is missing.
    """
    check_extra("onnx")
    import onnx
    from google.protobuf.message import DecodeError
    from onnx.utils import Extractor

    path = pathlib.Path(path)
    check_regular(path, _EXPECTED)
    with reading(path, _EXPECTED, DecodeError):
        model = onnx.load_model_from_string(read_bytes(path, _EXPECTED, MAX_ONNX_BYTES))
        try:
            description = from_metadata({it.key: it.value for it in model.metadata_props})
        except KeyError as error:
            raise ValueError(f"{reason(error)} is missing in the metadata") from error
        except (TypeError, AttributeError) as error:
            raise ValueError(reason(error)) from error
        _check_graph(model)
        _check_ends(model.graph, description)
        extractor = Extractor(model)
        features = list[str](FEATURES)
        encoder = extractor.extract_model(["mel"], features).SerializeToString()
        sampler = extractor.extract_model([*features, "style", "seed_pose"], [OUTPUT]).SerializeToString()
        return description, Parts(encoder, sampler)


def _check_graph(model: "onnx.ModelProto") -> None:
    """Check that a graph stands alone: no code, no other files, no graph in a graph."""
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
    made = [*(it.name for it in graph.initializer), *(name for node in graph.node for name in node.output)]
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
    }
    if tuple(it.name for it in graph.input) != INPUTS or [it.name for it in graph.output] != [OUTPUT]:
        raise ValueError(f"its inputs and outputs are not {', '.join(INPUTS)} and {OUTPUT}")
    shapes = {it.name: _shape(it) for it in (*graph.input, *graph.output)}
    for name, shape in (expected | {OUTPUT: (frames, bones, 3)}).items():
        if shapes[name] != shape:
            raise ValueError(f"{name} has shape {shapes[name]} instead of {shape}")


def _shape(value: "onnx.ValueInfoProto") -> tuple[int, ...]:
    """Return the shape of a value without the batch axis; -1 for a size that is not fixed."""
    sizes = value.type.tensor_type.shape.dim[1:]
    return tuple(it.dim_value if it.HasField("dim_value") else -1 for it in sizes)
