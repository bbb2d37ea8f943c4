"""The networks of HA2G as a graph of ONNX, built node by node: audio encoder, style coordinator, pose inferer.

The audio encoder is `layers.resnet_se`, channels first. A batch normalisation after a convolution becomes part of it.
One before a convolution with padding cannot: beyond the border there are zeros, not normalised values. One before the
linear map of a head stays separate: the factor of a nearly constant channel is in the hundreds, and with int8 weights
that contain it the other channels would lose their precision.

The stages of the inferer (`methods.ha2g.model`) work on (N, B, channels), the order of the operator GRU of ONNX.
"""

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from ha2g_jax.features.spectrum import NUM_MELS, window_columns
from ha2g_jax.layers.conv import EPSILON
from ha2g_jax.layers.resampling import interpolate
from ha2g_jax.layers.resnet_se import HEADS, MEL_RANGE, AudioEncoder, Features, head_grid, head_places
from ha2g_jax.methods.ha2g.model import HA2G
from ha2g_jax.skeleton import MIN_NORM, Skeleton

OPSET, IR_VERSION = 15, 8  # old enough for the runtimes of engines, new enough for DequantizeLinear of rows
Tree = dict[str, Any]

WEIGHTS = ("float32", "float16", "int8")
_EXCLUDED = -1e9  # score of an excluded audio level, whose weight is then 0
_SMALL = 1024  # arrays with fewer weights stay float32: they take little space, and biases need the precision


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

    def add(self, op: str, *inputs: str, name: str = "", **attributes: Any) -> str:
        """Add a node and return its name, made unique, which is that of its output; by default that of the operator.

        An optional input that is left out has the name "".
        """
        name = self._unique(name or op.lower())
        self._nodes.append(helper.make_node(op, inputs, [name], name=name, **attributes))
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

        In int8 each output channel, along `axis`, has its own scale.
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
        """Return the whole model with the shapes of its inputs and outputs by name; a string is a variable size.

        `inner` has the shapes of values between the two at which a reader may divide the graph.
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


def add_encoder(graph: Graph, encoder: AudioEncoder, params: Tree, stats: Tree, mel: str) -> list[str]:
    """Add the encoder of a mel (B, 128, columns) in dB to a graph.

    The result has the names of f_low, f_mid and f_high, each (B, N, feature_dim).
    """
    x = graph.add("Unsqueeze", mel, graph.constant([1]))
    x = graph.add("Add", graph.add("Div", x, graph.constant(MEL_RANGE)), graph.constant(1.0))  # D3
    kernel, bias = params["stem"]["conv"]["kernel"], params["stem"]["conv"]["bias"]
    x = _convolve(graph, x, kernel, bias, "stem", strides=encoder.stem_stride, padding=1)
    x = _normalize(graph, graph.add("Relu", x), params["stem"]["norm"], stats["stem"]["norm"])
    size = [-(-full // stride) for full, stride in zip(_mel_size(encoder), encoder.stem_stride, strict=True)]
    sizes, maps = [], []
    for index, blocks in enumerate(encoder.blocks):
        name = f"stage_{index + 1}"
        for block in range(blocks):
            part = (params[name][f"block_{block}"], stats[name][f"block_{block}"])
            x = _add_block(graph, x, *part, stride=2 if index and not block else 1, name=f"{name}.{block}")
        size = [-(-length // 2) for length in size] if index else size
        sizes.append(size)
        maps.append(x)
    grid = head_grid([columns for _, columns in sizes[1:]], encoder.num_frames, encoder.fps)
    return [
        _add_head(graph, level, size, params[name], stats[name], grid, name)
        for level, size, name in zip(maps[1:], sizes[1:], HEADS, strict=True)
    ]


def _mel_size(encoder: AudioEncoder) -> tuple[int, int]:
    return NUM_MELS, window_columns(encoder.num_frames, encoder.fps)


def _add_block(graph: Graph, x: str, params: Tree, stats: Tree, *, stride: int, name: str) -> str:
    """Add a `BasicBlock`."""
    y = _convolve(graph, x, params["conv_1"]["kernel"], None, f"{name}.conv_1", strides=(stride, stride), padding=1)
    y = _normalize(graph, graph.add("Relu", y), params["norm_1"], stats["norm_1"])
    factor, shift = _factor_and_shift(params["norm_2"], stats["norm_2"])
    y = _convolve(graph, y, params["conv_2"]["kernel"] * factor, shift, f"{name}.conv_2", padding=1)
    gate = graph.add("GlobalAveragePool", y)
    for layer, function in (("squeeze", "Relu"), ("excite", "Sigmoid")):  # linear maps as convolutions of one pixel
        kernel = params["se"][layer]["kernel"][None, None]
        gate = _convolve(graph, gate, kernel, params["se"][layer]["bias"], f"{name}.{layer}")
        gate = graph.add(function, gate)
    y = graph.add("Mul", y, gate)
    if "shortcut_conv" in params:
        factor, shift = _factor_and_shift(params["shortcut_norm"], stats["shortcut_norm"])
        kernel = params["shortcut_conv"]["kernel"] * factor
        x = _convolve(graph, x, kernel, shift, f"{name}.shortcut", strides=(stride, stride))
    return graph.add("Relu", graph.add("Add", x, y))


def _add_head(
    graph: Graph, x: str, size: list[int], params: Tree, stats: Tree, grid: tuple[int, float] | None, name: str
) -> str:
    """Add a `Head` on a map of a size, height and columns, before the pixel shuffle."""
    factor, kernel_size = HEADS[name]
    if factor > 1:
        x = graph.add("DepthToSpace", x, blocksize=factor, mode="CRD")
    if grid is not None:
        columns = jnp.eye(factor * size[1], dtype=jnp.float32)
        matrix = np.asarray(interpolate(columns, head_places(kernel_size, *grid), axis=0)).T
        x = graph.add("MatMul", x, graph.constant(matrix, f"{name}.columns"))
    x = _convolve(graph, x, params["conv"]["kernel"], params["conv"]["bias"], f"{name}.conv")
    x = graph.add("Relu", x)
    # The features of a frame are all rows of channel 0, then those of channel 1, and so on.
    x = graph.add("Reshape", graph.add("Transpose", x, perm=[0, 3, 1, 2]), graph.constant([0, 0, -1]))
    rows = factor * size[0] - kernel_size + 1
    scale, shift = (np.repeat(it, rows) for it in _factor_and_shift(params["norm"], stats["norm"]))
    kernel, bias = np.asarray(params["linear"]["kernel"]), np.asarray(params["linear"]["bias"])
    x = graph.add("Mul", x, graph.constant(scale, f"{name}.scale"))
    x = graph.add("Add", x, graph.constant(shift, f"{name}.shift"))
    x = graph.add("MatMul", x, graph.weight(kernel, f"{name}.linear", axis=1))
    return graph.add("Add", x, graph.constant(bias), name=f"f_{name}")


def _convolve(
    graph: Graph,
    x: str,
    kernel: Any,
    bias: Any,
    name: str,
    *,
    strides: tuple[int, int] = (1, 1),
    padding: int = 0,
) -> str:
    """Add a convolution with a kernel (height, width, inputs, channels)."""
    kernel = np.asarray(kernel).transpose(3, 2, 0, 1)
    weights = [graph.weight(kernel, f"{name}.kernel")]
    if bias is not None:
        weights.append(graph.constant(np.asarray(bias), f"{name}.bias"))
    shape = list(kernel.shape[2:])
    return graph.add("Conv", x, *weights, name=name, kernel_shape=shape, strides=list(strides), pads=[padding] * 4)


def _normalize(graph: Graph, x: str, params: Tree, stats: Tree) -> str:
    """Add a batch normalisation that cannot be part of another layer."""
    parts = (params["scale"], params["bias"], stats["mean"], stats["variance"])
    return graph.add(
        "BatchNormalization", x, *(graph.constant(np.asarray(it), "norm") for it in parts), epsilon=EPSILON
    )


def _factor_and_shift(params: Tree, stats: Tree) -> tuple[np.ndarray, np.ndarray]:
    """Return a batch normalisation as y = factor x + shift, for each channel."""
    scale, bias, mean, variance = (
        np.asarray(it, np.float64) for it in (params["scale"], params["bias"], stats["mean"], stats["variance"])
    )
    factor = scale / np.sqrt(variance + EPSILON)
    return factor, bias - mean * factor


def add_inferer(
    graph: Graph,
    model: HA2G,
    skeleton: Skeleton,
    params: Tree,
    features: Sequence[str],
    style: str,
    seed_pose: str,
    noise: str,
) -> str:
    """Add the coordinator and all stages to a graph, and return the name of the poses (B, N, bones, 3), unit vectors.

    Features f_low, f_mid and f_high (B, N, features), style (B, style_dim), seed pose (B, M, bones, 3), unit vectors,
    and noise (B, N, noise_dim), where the model has any, are names of values. The mean of the skeleton is subtracted
    from poses and added to them (D1).
    """
    mean, free = graph.constant(skeleton.mean_directions, "mean_directions"), None
    seed = graph.add("Reshape", graph.add("Sub", seed_pose, mean), graph.constant([0, 0, skeleton.pose_dim]))
    seed = graph.add("Transpose", seed, perm=[1, 0, 2])
    # After the last channel follows the bit that marks the frames of the seed pose.
    seed = graph.add("Pad", seed, graph.constant([0, 0, 0, 0, 0, 1]), graph.constant(1.0))
    blended = _add_coordinator(graph, model, params["coordinator"], features, style)
    noises = [graph.add("Transpose", noise, perm=[1, 0, 2])] if model.noise_dim else []
    num_free = model.audio.num_frames - model.num_seed_frames
    poses = ""
    for level, channels in enumerate(model.level_channels):
        below = model.level_channels[max(level - 1, 0)]
        previous = graph.add("Gather", seed, graph.constant([*channels, skeleton.pose_dim]), axis=2)
        if level:
            # Channels that the level below does not have, and the bit, are padded with zeros.
            zero = len(below)
            free = graph.add("Slice", poses, *(graph.constant([it]) for it in (model.num_seed_frames, 1 << 30, 0)))
            free = graph.add("Pad", free, graph.constant([0, 0, 0, 0, 0, 1]))
            places = [below.index(channel) if channel in below else zero for channel in channels]
            free = graph.add("Gather", free, graph.constant([*places, zero]), axis=2)
            previous = graph.add("Concat", previous, free, axis=0)
        else:
            previous = graph.add("Pad", previous, graph.constant([0, 0, 0, num_free, 0, 0]))
        inputs = graph.add("Concat", previous, blended[level], *noises, axis=2)
        poses = _add_stage(graph, model, params[f"pose_{level + 1}"], inputs, len(channels), f"pose_{level + 1}")
    vectors = graph.add("Transpose", poses, perm=[1, 0, 2])
    vectors = graph.add("Reshape", vectors, graph.constant([0, 0, skeleton.num_bones, 3]))
    return _unit_vectors(graph, graph.add("Add", vectors, mean))


def _add_coordinator(graph: Graph, model: HA2G, params: Tree, features: Sequence[str], style: str) -> list[str]:
    """Add Eq. 3: return the names of the audio features of each level, each (N, B, features)."""
    audio, levels = len(Features._fields), len(model.level_channels)
    kernel = np.asarray(params["linear"]["kernel"]).reshape(-1, audio, 1 if model.is_tied else levels)
    bias = np.array(params["linear"]["bias"]).reshape(audio, -1)
    counts = np.array([name in model.audio_levels for name in Features._fields])
    kernel, bias = kernel * counts[:, None], np.where(counts[:, None], bias, _EXCLUDED)
    kernel, bias = (np.broadcast_to(it, (*it.shape[:-1], levels)) for it in (kernel, bias))
    # Levels of the motion first, those of the audio last, as the product below takes them.
    kernel, bias = kernel.swapaxes(1, 2).reshape(len(kernel), -1), bias.T.reshape(-1)
    scores = graph.add("MatMul", style, graph.constant(kernel, "coordinator"))
    scores = graph.add("Add", scores, graph.constant(bias, "coordinator_bias"))
    weights = graph.add("Reshape", scores, graph.constant([-1, levels, audio]))
    weights = graph.add("Softmax", weights, axis=2)
    axis = graph.constant([1])
    flat = [graph.add("Unsqueeze", graph.add("Flatten", feature), axis) for feature in features]
    blended = graph.add("MatMul", weights, graph.add("Concat", *flat, axis=1))
    shape = [0, levels, model.audio.num_frames, model.audio.feature_dim]
    blended = graph.add("Transpose", graph.add("Reshape", blended, graph.constant(shape)), perm=[1, 2, 0, 3])
    return [graph.add("Gather", blended, graph.constant(level), axis=0) for level in range(levels)]


def _add_stage(graph: Graph, model: HA2G, params: Tree, inputs: str, channels: int, name: str) -> str:
    """Add a `PoseStage`; its inputs are (N, B, channels + 1 + features and noise), with the bit after the channels."""
    x, states = inputs, ""
    for layer in range(model.layers):
        if layer:
            x = graph.add("Transpose", states, perm=[0, 2, 1, 3])
            x = graph.add("Reshape", x, graph.constant([0, 0, -1]))
        weights = _gru_weights(params["gru"], layer, channels if layer == 0 else None)
        states = _add_gru(graph, model.hidden_dim, x, *weights, name=f"{name}.gru_{layer}")
    hidden = graph.add("ReduceSum", states, graph.constant([1]), keepdims=0)
    kernel = np.asarray(params["linear"]["kernel"])
    kernel = np.insert(kernel, model.hidden_dim + channels, 0, axis=0)  # the linear map does not see the bit
    outputs = graph.add("Concat", hidden, inputs, axis=2)
    outputs = graph.add("MatMul", outputs, graph.weight(kernel, f"{name}.linear", axis=1))
    return graph.add("Add", outputs, graph.constant(np.asarray(params["linear"]["bias"]), f"{name}.bias"))


def _gru_weights(params: Tree, layer: int, channels: int | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return W (2 * 3 h, inputs), R (2 * 3 h, h) and B (2, 6 h) of a layer of a `BiGRU`, with the gates as z, r, h.

    The seed bit is moved from the last place to that before the input `channels`, unless that is None.
    """
    parts = []
    for suffix in ("", "_reverse"):
        input_weight, hidden_weight, input_bias, hidden_bias = (
            np.asarray(params[f"{kind}_l{layer}{suffix}"]) for kind in ("weight_ih", "weight_hh", "bias_ih", "bias_hh")
        )
        if channels is not None:
            rest, bit = input_weight[:, :-1], input_weight[:, -1]
            input_weight = np.insert(rest, channels, bit, axis=1)
        parts.append([_update_first(it) for it in (input_weight, hidden_weight, input_bias, hidden_bias)])
    w, r, *biases = (np.stack(both) for both in zip(*parts, strict=True))
    return w.reshape(-1, w.shape[-1]), r.reshape(-1, r.shape[-1]), np.concatenate(biases, axis=1)


def _update_first(stacked: np.ndarray) -> np.ndarray:
    """Return the stacked gates r, z, n in the order z, r, n."""
    reset, update, new = np.split(stacked, 3)
    return np.concatenate([update, reset, new])


def _add_gru(
    graph: Graph, hidden_dim: int, x: str, w: np.ndarray, r: np.ndarray, biases: np.ndarray, *, name: str
) -> str:
    """Add one layer of both directions; its states are (N, 2, B, h)."""
    shape = graph.constant([2, 3 * hidden_dim, -1])
    kernels = ((w, "w"), (r, "r"))
    return graph.add(
        "GRU",
        x,
        *(graph.add("Reshape", graph.weight(it, f"{name}.{part}"), shape) for it, part in kernels),
        graph.constant(biases, f"{name}.b"),
        name=name,
        hidden_size=hidden_dim,
        direction="bidirectional",
        linear_before_reset=1,  # the equations of PyTorch, see `layers.gru_cell`
    )


def _unit_vectors(graph: Graph, vectors: str) -> str:
    """Add `skeleton.normalize`."""
    squared = graph.add("ReduceSum", graph.add("Mul", vectors, vectors), graph.constant([-1]), keepdims=1)
    squared = graph.add("Max", squared, graph.constant(MIN_NORM**2))
    return graph.add("Div", vectors, graph.add("Sqrt", squared), name="poses")
