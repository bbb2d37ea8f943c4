"""The audio encoder E_a of `layers.resnet_se` as nodes of ONNX, channels first.

A batch normalisation after a convolution becomes part of it. One before a convolution with padding cannot: beyond the
border there are zeros, not normalised values. One before the linear map of a head stays apart: the factor of a channel
that is nearly constant is in the hundreds, and int8 weights that contained it would leave no precision to the others.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np

from ha2g_jax.checkpoint.onnx.graph import Graph
from ha2g_jax.features.spectrum import NUM_MELS, window_columns
from ha2g_jax.layers.norm import EPSILON
from ha2g_jax.layers.resampling import interpolate
from ha2g_jax.layers.resnet_se import HEADS, MEL_RANGE, AudioEncoder, head_grid, head_places

Tree = dict[str, Any]


def add_encoder(graph: Graph, encoder: AudioEncoder, params: Tree, stats: Tree, mel: str) -> list[str]:
    """Add the encoder to a graph.

    Args:
        graph: graph that takes the nodes.
        encoder: sizes of the encoder.
        params, stats: its parameters and statistics.
        mel: name of the value (B, 128, columns) in dB.

    Returns:
        The names of f_low, f_mid and f_high, each (B, N, feature_dim).
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
