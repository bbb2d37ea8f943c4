"""Bounds on an untrusted ONNX file, which are checked before it is unpacked and before it runs."""

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ha2g_jax.limits import MAX_ONNX_GRAPH_BYTES, MAX_ONNX_MEMORY, MAX_ONNX_PRODUCTS

if TYPE_CHECKING:
    import onnx

Shape = tuple[int, ...]

# The fields that may be large, by their numbers: graph.initializer.raw_data, and metadata_props.value.
_LARGE: Mapping[int, Any] = {7: {5: {9: None}}, 14: {2: None}}
_VARINT, _BYTES, _FIXED = 0, 2, {1: 8, 5: 4}  # kinds of fields of protobuf, and bytes of those of fixed size
_FLOAT, _INT64 = 1, 7
_ITEM_BYTES = {_FLOAT: 4, 3: 1, _INT64: 8, 10: 2}  # of a weight by its type; 3 and 10 are int8 and float16
_PRODUCTS_OF_A_VALUE = 16  # multiplications that take as long as reading a value
_PRODUCTS_OF_A_STEP = 4096  # multiplications that take as long as starting a matrix product
_COPIES = 4  # maximum number of copies of the weights while a file is read
_MAX_INTEGER = 1 << 30  # largest constant: a position, a size, or "to the end"


def check_bytes(content: bytes) -> None:
    """Check the bytes other than weights and metadata, which as messages take up to a hundred times as much memory.

    Raises:
        ValueError: there are too many, or the content is no message of protobuf.
    """
    if _small_bytes(memoryview(content), _LARGE) > MAX_ONNX_GRAPH_BYTES:
        raise ValueError(f"more than {MAX_ONNX_GRAPH_BYTES} bytes beside weights and metadata")


def _small_bytes(message: memoryview, large: Mapping[int, Any]) -> int:
    """Return the bytes of a message other than its large fields, counted until they are too many."""
    place = found = 0
    while place < len(message) and found <= MAX_ONNX_GRAPH_BYTES:
        start = place
        key, place = _number(message, place)
        number, kind = key >> 3, key & 7
        length = _FIXED.get(kind, 0)
        if kind in (_VARINT, _BYTES):
            value, place = _number(message, place)
            length = value if kind == _BYTES else 0
        part, place = message[place : place + length], place + length
        found += place - start
        if kind == _BYTES and number in large:
            found += (_small_bytes(part, large[number]) if large[number] else 0) - length
    return found


def _number(message: memoryview, place: int) -> tuple[int, int]:
    """Return a number of variable length and the position after it."""
    number = 0
    for shift, byte in enumerate(message[place : place + 10]):
        number |= (byte & 127) << (7 * shift)
        if byte < 128:
            return number, place + shift + 1
    raise ValueError("cut short or damaged")


def check_cost(model: "onnx.ModelProto") -> None:
    """Check the memory and the multiplications of one window.

    Sizes are inferred without the weights. A size that depends on computed values is unknown, and is refused.

    Raises:
        ValueError, IndexError, onnx.shape_inference.InferenceError: there are too many, or sizes are unknown or wrong.
    """
    from onnx import ModelProto, helper, shape_inference

    bare = ModelProto(ir_version=model.ir_version, opset_import=model.opset_import)
    bare.graph.node.extend(model.graph.node)
    bare.graph.input.extend(model.graph.input)
    for value in bare.graph.input:
        value.type.tensor_type.shape.dim[0].dim_value = 1
    for tensor in model.graph.initializer:
        if len(tensor.raw_data) != math.prod(tensor.dims) * _ITEM_BYTES.get(tensor.data_type, -1):
            raise ValueError(f"weights of shape {tuple(tensor.dims)} in {len(tensor.raw_data)} bytes")
        if tensor.data_type != _INT64:
            bare.graph.input.append(helper.make_tensor_value_info(tensor.name, tensor.data_type, tensor.dims))
        elif all(abs(number) <= _MAX_INTEGER for number in _extremes(tensor.raw_data)):
            bare.graph.initializer.append(tensor)
        else:
            raise ValueError(f"an integer above {_MAX_INTEGER}")
    graph = shape_inference.infer_shapes(bare, strict_mode=True).graph
    shapes = {it.name: tuple(it.dims) for it in graph.initializer} | {"": ()}
    shapes |= {it.name: _shape(it) for it in (*graph.input, *graph.value_info)}
    floats = {it.name for it in graph.value_info if it.type.tensor_type.elem_type == _FLOAT and -1 not in _shape(it)}
    memory, products = _COPIES * sum(len(tensor.raw_data) for tensor in model.graph.initializer), 0
    constants = {tensor.name for tensor in model.graph.initializer} | {""}
    for node in graph.node:
        if not floats.issuperset(filter(None, node.output)):
            raise ValueError(f"the size of the output of {node.op_type} depends on its values")
        inputs = [shapes[name] for name in node.input]
        outputs = sum(math.prod(shapes[name]) for name in node.output)
        copies = 1
        if constants.issuperset(node.input):  # computed and stored before the first window
            constants.update(node.output)
            copies = 2 if outputs <= sum(map(math.prod, inputs)) else 3
        memory += copies * outputs * _ITEM_BYTES[_FLOAT]
        products += _products(node.op_type, inputs, outputs)
    if memory > MAX_ONNX_MEMORY or products > MAX_ONNX_PRODUCTS:
        raise ValueError(
            f"a window takes {memory} bytes and {products} multiplications, instead of at most {MAX_ONNX_MEMORY} and "
            f"{MAX_ONNX_PRODUCTS}"
        )


def _extremes(integers: bytes) -> list[int]:
    array = np.frombuffer(integers, "<i8")
    return [int(array.min()), int(array.max())] if len(array) else []


def _shape(value: "onnx.ValueInfoProto") -> Shape:
    """Return the shape of a value; -1 for a size that is not known, and as the shape where its rank is not."""
    if not value.type.tensor_type.HasField("shape"):
        return (-1,)
    return tuple(it.dim_value if it.HasField("dim_value") else -1 for it in value.type.tensor_type.shape.dim)


def _products(operator: str, inputs: Sequence[Shape], outputs: int) -> int:
    """Return the multiplications of a node, or an equivalent number for moving its values and starting its steps."""
    moved = _PRODUCTS_OF_A_VALUE * (outputs + sum(map(math.prod, inputs)))
    if operator == "MatMul":
        steps = math.prod(np.broadcast_shapes(*(shape[:-2] for shape in inputs)))
        return max(moved, outputs * inputs[0][-1], _PRODUCTS_OF_A_STEP * steps)
    if operator == "Conv":  # of few channels, its values are moved as often as they are multiplied
        (_, channels, *_), (kernels, depth, *_) = inputs[:2]
        products = outputs * math.prod(inputs[1][1:])
        return max(moved, products, _PRODUCTS_OF_A_VALUE * products * channels // max(1, kernels * depth))
    if operator == "GRU":  # reads its weights in each step, which takes twice as long as the products
        frames, batch, _ = inputs[0]
        return max(moved, frames * (_PRODUCTS_OF_A_STEP + 2 * batch * sum(map(math.prod, inputs[1:3]))))
    return moved
