"""The style coordinator and the pose inferer of `methods.ha2g.model` as nodes of ONNX.

The nodes of a stage work on (N, B, channels), the order of the operator GRU of ONNX.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ha2g_jax.checkpoint.onnx.graph import Graph
from ha2g_jax.layers.resnet_se import Features
from ha2g_jax.methods.ha2g.model import HA2G
from ha2g_jax.skeleton import MIN_NORM, Skeleton

Tree = dict[str, Any]

_EXCLUDED = -1e9  # score of an audio level that does not count, whose weight is then 0


class GruWeights(NamedTuple):
    """Weights of a bidirectional layer.

    Attributes:
        inputs: W (2 * 3 h, inputs).
        hidden: R (2 * 3 h, h).
        biases: B (2, 6 h).
    """

    inputs: np.ndarray
    hidden: np.ndarray
    biases: np.ndarray


def add_inferer(
    graph: Graph, model: HA2G, skeleton: Skeleton, params: Tree, features: Sequence[str], style: str, seed_pose: str
) -> str:
    """Add the coordinator and all stages to a graph.

    Args:
        graph: graph that takes the nodes.
        model: sizes of the networks.
        skeleton: skeleton, with the mean that is subtracted from poses and added to them (D1).
        params: parameters of the generator.
        features: names of f_low, f_mid and f_high, each (B, N, features).
        style: name of the value (B, style_dim).
        seed_pose: name of the value (B, M, bones, 3), unit vectors.

    Returns:
        The name of the poses (B, N, bones, 3), unit vectors.
    """
    mean, free = graph.constant(skeleton.mean_directions, "mean_directions"), None
    seed = graph.add("Reshape", graph.add("Sub", seed_pose, mean), graph.constant([0, 0, skeleton.pose_dim]))
    seed = graph.add("Transpose", seed, perm=[1, 0, 2])
    # After the last channel there is the bit that marks the frames of the seed pose.
    seed = graph.add("Pad", seed, graph.constant([0, 0, 0, 0, 0, 1]), graph.constant(1.0))
    blended = _add_coordinator(graph, model, params["coordinator"], features, style)
    num_free = model.audio.num_frames - model.num_seed_frames
    poses = ""
    for level, own in enumerate(model.level_channels):
        below = model.level_channels[max(level - 1, 0)]
        channels = own if model.seed_level == "own" else below
        previous = graph.add("Gather", seed, graph.constant([*channels, skeleton.pose_dim]), axis=2)
        if level:
            # Channels that the level below does not have, and the bit, are the zero that is padded.
            zero = len(below)
            free = graph.add("Slice", poses, *(graph.constant([it]) for it in (model.num_seed_frames, 1 << 30, 0)))
            free = graph.add("Pad", free, graph.constant([0, 0, 0, 0, 0, 1]))
            places = [below.index(channel) if channel in below else zero for channel in channels]
            free = graph.add("Gather", free, graph.constant([*places, zero]), axis=2)
            previous = graph.add("Concat", previous, free, axis=0)
        else:
            previous = graph.add("Pad", previous, graph.constant([0, 0, 0, num_free, 0, 0]))
        inputs = graph.add("Concat", previous, blended[level], axis=2)
        poses = _add_stage(graph, model, params[f"pose_{level + 1}"], inputs, len(channels), f"pose_{level + 1}")
    vectors = graph.add("Transpose", poses, perm=[1, 0, 2])
    vectors = graph.add("Reshape", vectors, graph.constant([0, 0, skeleton.num_bones, 3]))
    return _normalize(graph, graph.add("Add", vectors, mean))


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
    """Add a `PoseStage`; its inputs are (N, B, channels + 1 + features), with the seed bit after the channels."""
    x, states = inputs, ""
    for layer in range(model.layers):
        if layer:
            x = graph.add("Transpose", states, perm=[0, 2, 1, 3])
            x = graph.add("Reshape", x, graph.constant([0, 0, -1]))
        weights = _gru_weights(params["gru"], layer, channels if layer == 0 else None)
        states = _add_gru(graph, model.hidden_dim, x, weights, f"{name}.gru_{layer}")
    hidden = graph.add("ReduceSum", states, graph.constant([1]), keepdims=0)
    kernel = np.asarray(params["linear"]["kernel"])
    kernel = np.insert(kernel, model.hidden_dim + channels, 0, axis=0)  # the linear map does not see the bit
    outputs = graph.add("Concat", hidden, inputs, axis=2)
    outputs = graph.add("MatMul", outputs, graph.weight(kernel, f"{name}.linear", axis=1))
    return graph.add("Add", outputs, graph.constant(np.asarray(params["linear"]["bias"]), f"{name}.bias"))


def _gru_weights(params: Tree, layer: int, channels: int | None) -> GruWeights:
    """Return the weights of a bidirectional layer as ONNX has them, with the gates in the order z, r, h.

    Args:
        params: parameters of a `BiGRU`.
        layer: number of the layer.
        channels: number of the input before which the seed bit is moved from the last place; None for no move.
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
    return GruWeights(w.reshape(-1, w.shape[-1]), r.reshape(-1, r.shape[-1]), np.concatenate(biases, axis=1))


def _update_first(stacked: np.ndarray) -> np.ndarray:
    """Return the gates r, z, n, one below the other, in the order z, r, n."""
    reset, update, new = np.split(stacked, 3)
    return np.concatenate([update, reset, new])


def _add_gru(graph: Graph, hidden_dim: int, x: str, weights: GruWeights, name: str) -> str:
    """Add one layer of both directions; its states are (N, 2, B, h)."""
    shape = graph.constant([2, 3 * hidden_dim, -1])
    kernels = ((weights.inputs, "w"), (weights.hidden, "r"))
    return graph.add(
        "GRU",
        x,
        *(graph.add("Reshape", graph.weight(it, f"{name}.{part}"), shape) for it, part in kernels),
        graph.constant(weights.biases, f"{name}.b"),
        name=name,
        hidden_size=hidden_dim,
        direction="bidirectional",
        linear_before_reset=1,  # the equations of PyTorch, see `layers.gru_scan`
    )


def _normalize(graph: Graph, vectors: str) -> str:
    """Add `skeleton.normalize`."""
    squared = graph.add("ReduceSum", graph.add("Mul", vectors, vectors), graph.constant([-1]), keepdims=1)
    squared = graph.add("Max", squared, graph.constant(MIN_NORM**2))
    return graph.add("Div", vectors, graph.add("Sqrt", squared), name="poses")
