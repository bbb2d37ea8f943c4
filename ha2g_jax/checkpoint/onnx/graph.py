"""A graph of ONNX that grows node by node, and the forms in which it stores weights."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

OPSET, IR_VERSION = 15, 8  # old enough for the runtimes of engines, new enough for DequantizeLinear of rows
WEIGHTS = ("float32", "float16", "int8")
_SMALL = 1024  # weights that are fewer stay float32: they take no space, and biases need the precision


class Graph:
    """Nodes and constants of a graph; values are named by strings, as in ONNX.

    Args:
        weights: form of large weights in the file, one of `WEIGHTS`. float16 and int8 are made float32 by a node, so
            that all computation is float32; int8 has one scale for each output channel.
    """

    def __init__(self, weights: str = "float32"):
        self._weights = weights
        self._nodes: list[onnx.NodeProto] = []
        self._constants: dict[str, onnx.TensorProto] = {}
        self._names: dict[str, int] = {}

    def add(self, op: str, *inputs: str, name: str = "", outputs: int = 1, **attributes: Any) -> str:
        """Add a node.

        Args:
            op: operator of ONNX.
            inputs: names of values; "" for an optional input that is left out.
            name: name of the node and of its output, made unique; by default that of the operator.
            outputs: number of outputs; only the first is returned.
            attributes: attributes of the operator.

        Returns:
            The name of the first output.
        """
        name = self._unique(name or op.lower())
        names = [name, *(f"{name}_{index}" for index in range(1, outputs))]
        self._nodes.append(helper.make_node(op, inputs, names, name=name, **attributes))
        return name

    def constant(self, values: Any, name: str = "constant") -> str:
        """Add an array of float32 or int64 and return its name; equal small arrays are stored once."""
        array = np.asarray(values)
        array = array.astype(np.int64 if np.issubdtype(array.dtype, np.integer) else np.float32)
        if array.size <= 16:
            for known, tensor in self._constants.items():
                if tensor.raw_data == array.tobytes() and tuple(tensor.dims) == array.shape:
                    return known
        return self._store(array, name)

    def weight(self, array: np.ndarray, name: str, axis: int = 0) -> str:
        """Add a weight in the form of this graph and return the name of its float32 value.

        Args:
            array: weight of a layer.
            name: name of the layer.
            axis: axis of the output channels, each of which has its own scale in int8.
        """
        array = np.ascontiguousarray(array, np.float32)
        if self._weights == "float32" or array.size < _SMALL:
            return self._store(array, name)
        if self._weights == "float16":
            return self.add("Cast", self._store(array.astype(np.float16), f"{name}_half"), name=name, to=1)
        others = tuple(index for index in range(array.ndim) if index != axis)
        scale = np.maximum(np.abs(array).max(others, keepdims=True) / 127, np.float32(1e-12))
        rounded = np.rint(array / scale).astype(np.int8)
        stored = self._store(rounded, f"{name}_int8"), self._store(scale.reshape(-1), f"{name}_scale")
        return self.add("DequantizeLinear", *stored, name=name, axis=axis)

    def model(
        self,
        inputs: dict[str, Sequence[Any]],
        outputs: dict[str, Sequence[Any]],
        inner: dict[str, Sequence[Any]],
        metadata: dict[str, str],
    ) -> onnx.ModelProto:
        """Return the whole model.

        Args:
            inputs: shape of each input; a text is a size that is not fixed.
            outputs: shape of each output, which is the value of the same name.
            inner: shape of values between the two at which a reader may divide the graph.
            metadata: texts by name.
        """
        sides = [
            [helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name, shape in them.items()]
            for them in (inputs, outputs, inner)
        ]
        constants = list(self._constants.values())
        graph = helper.make_graph(self._nodes, "ha2g", *sides[:2], initializer=constants, value_info=sides[2])
        opset = [helper.make_opsetid("", OPSET)]
        model = helper.make_model(graph, opset_imports=opset, ir_version=IR_VERSION, producer_name="ha2g-jax")
        helper.set_model_props(model, metadata)
        return model

    def _store(self, array: np.ndarray, name: str) -> str:
        name = self._unique(name)
        self._constants[name] = numpy_helper.from_array(np.array(array, order="C"), name)
        return name

    def _unique(self, name: str) -> str:
        number = self._names[name] = self._names.get(name, 0) + 1
        return name if number == 1 else f"{name}.{number}"
