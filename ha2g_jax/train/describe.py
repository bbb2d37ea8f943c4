"""Shapes and parameter counts of the modules that a config builds, without running them."""

import math
from typing import Any

import jax
import jax.numpy as jnp
from flax import linen as nn
from flax import traverse_util

from ha2g_jax.config.settings import Config
from ha2g_jax.layers.conv import BatchNorm, Conv
from ha2g_jax.layers.identity import ResNet
from ha2g_jax.layers.resnet_se import Head, Stage, Stem
from ha2g_jax.methods import build, method_of
from ha2g_jax.methods.autoencoder import LATENT_DIMS, PoseAutoencoder
from ha2g_jax.methods.method import example_batch
from ha2g_jax.skeleton import load_skeleton

Row = dict[str, Any]

_DEPTH = 2
# Modules whose shapes the tables of the paper print with the channels first; sequences are frames x values.
_CHANNELS_FIRST = (Stem, Stage, Head, ResNet, BatchNorm, Conv, nn.Conv, nn.ConvTranspose)


def describe(config: Config) -> list[Row]:
    """Return rows for the generator, the discriminator and the pose auto-encoder, and for their parts, two levels down.

    Shapes of feature maps and convolutions are channels first, as in Tables 6 to 9; shapes of sequences are frames x
    values. The batch axis is left out. The embedding tables of words and speakers grow with the data and are not
    counted. A row has "module" (dotted path), "input" and "output" (such as "64x64x35"; several are joined by ", "),
    "input_shapes" and "output_shapes" (lists) and "parameters" (of the module and its parts).
    """
    skeleton = load_skeleton(config.skeleton)
    spec = build(config, skeleton, vocabulary_size=1, num_speakers=1)
    poses = jnp.zeros((1, spec.num_frames, skeleton.pose_dim), jnp.float32)
    rows = _rows("generator", spec.generator, *method_of(spec).init_arguments(spec, example_batch(spec)))
    if spec.discriminator is not None:
        rows += _rows("discriminator", spec.discriminator, poses)
    autoencoder = PoseAutoencoder(skeleton.pose_dim, LATENT_DIMS[skeleton.name], spec.num_frames)
    return rows + _rows("autoencoder", autoencoder, poses)


def as_table(rows: list[Row]) -> str:
    """Format the rows of `describe` as an aligned table whose last line is the total of all networks."""
    header = ("module", "input", "output", "parameters")
    cells = [
        (
            "  " * row["module"].count(".") + row["module"].rpartition(".")[2],
            row["input"],
            row["output"],
            f"{row['parameters']:,}",
        )
        for row in rows
    ]
    total = sum(row["parameters"] for row in rows if "." not in row["module"])
    cells = [header, *cells, ("total", "", "", f"{total:,}")]
    widths = [max(len(line[column]) for line in cells) for column in range(len(header))]
    lines = [
        "  ".join([*(cell.ljust(width) for cell, width in zip(line[:-1], widths)), line[-1].rjust(widths[-1])])
        for line in cells
    ]
    rule = "-" * len(lines[0])
    note = "Shapes without the batch axis. Word and speaker tables, which grow with the data, are not counted."
    return "\n".join([lines[0], rule, *lines[1:-1], rule, lines[-1], note])


def _rows(name: str, module: nn.Module, *inputs: jax.Array) -> list[Row]:
    rows: dict[tuple[str, ...], Row] = {}

    def record(call, args, kwargs, context):
        path = context.module.path
        if context.method_name != "__call__" or len(path) > _DEPTH:
            return call(*args, **kwargs)
        row = rows.setdefault(path, {"module": ".".join((name, *path))})  # parents first: before their parts run
        output = call(*args, **kwargs)
        channels_first = isinstance(context.module, _CHANNELS_FIRST)
        for key, arrays in (("input", args), ("output", output)):
            shapes = [_shape(array, channels_first) for array in jax.tree.leaves(arrays)]
            row[key] = ", ".join("x".join(map(str, shape)) for shape in shapes)
            row[f"{key}_shapes"] = shapes
        return output

    with nn.intercept_methods(record):
        variables = jax.eval_shape(lambda key: module.init(key, *inputs, train=False), jax.random.key(0))
    leaves: dict[Any, Any] = traverse_util.flatten_dict(variables["params"])
    sizes = {path: math.prod(leaf.shape) for path, leaf in leaves.items()}
    for path, row in rows.items():
        row["parameters"] = sum(
            size for leaf, size in sizes.items() if leaf[: len(path)] == path and leaf[-1] != "embedding"
        )
    return [row for row in rows.values() if row["parameters"]]


def _shape(array: jax.Array, channels_first: bool) -> list[int]:
    shape = list(array.shape[1:])
    if channels_first and len(shape) > 1:
        # A head takes a feature map but returns a sequence; both have their channels last in the code.
        shape = [shape[-1], *shape[:-1]]
    return shape or [1]
