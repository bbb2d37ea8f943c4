"""The random choices of a generator by seed, for programs that have no generator of random numbers of NumPy."""

import dataclasses
import json
import pathlib
from typing import Any

import numpy as np

from ha2g_jax.checkpoint.onnx.reading import Description, read, to_metadata
from ha2g_jax.synthesis.style import RANDOM, Style, choose_style

NUM_SEEDS = 100

_TEXTS = ("format", "name", "method", "hash", "license", "weights")


def page_description(path: str | pathlib.Path, seeds: int = NUM_SEEDS) -> dict[str, Any]:
    """Return what a web page needs beside an ONNX file, the contents of its model.json.

    Args:
        path: file of `ha2g export-onnx`.
        seeds: number of seeds, from 0 on, whose random choices are included.

    Returns:
        The values of the file's metadata by name (docs/onnx.md), and "takes", see `takes`.

    Raises:
        UserError: see `checkpoint.onnx.reading.read`.
    """
    description, _ = read(path)
    metadata = to_metadata(description)
    values = {name: text if name in _TEXTS else json.loads(text) for name, text in metadata.items()}
    return values | {"takes": takes(description, seeds)}


def takes(description: Description, seeds: int = NUM_SEEDS) -> list[dict[str, Any]]:
    """Return the random choices of `Generator.generate` for each seed from 0 on.

    Args:
        description: model that generates.
        seeds: number of seeds.

    Returns:
        For each seed "style", the values of the style without a request; "variation", what is added to the style of a
        speaker or a mixture with a variation of 1; and "seed_pose", the number of the seed pose.
    """
    zero = np.zeros(description.style_dim, np.float32)
    no_style = dataclasses.replace(description.assets, speakers={"": zero})
    bank = description.assets.seed_poses
    found = []
    for seed in range(seeds):
        style, _ = choose_style(description, {}, description.assets, RANDOM, seed)
        variation, _ = choose_style(description, {}, no_style, Style(speaker="", variation=1.0), seed)
        seed_pose = int(np.random.default_rng(seed).integers(len(bank)))  # as in `generator.join`
        found.append({"style": _numbers(style), "variation": _numbers(variation), "seed_pose": seed_pose})
    return found


def _numbers(values: np.ndarray) -> list[float]:
    """Return the shortest decimals that give the same float32."""
    return [float(str(value)) for value in values]
