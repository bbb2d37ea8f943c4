"""What an ONNX file says of its model beside the graph: sizes, skeleton, speakers, seed poses, origin."""

import json
from collections.abc import Mapping
from typing import Any, NamedTuple

from ha2g_jax.checkpoint import assets as assets_module
from ha2g_jax.checkpoint.assets import Assets
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.features.spectrum import FFT_SIZE, FLOOR_DB, HOP_LENGTH, NUM_MELS, window_columns
from ha2g_jax.files.reading import parse_json
from ha2g_jax.limits import MAX_ASSETS_BYTES, MAX_CHANNELS, MAX_WINDOW_FRAMES

FORMAT = "ha2g-jax 1"
MIN_FRAMES, MIN_FPS, MAX_FPS = 17, 15, 30  # those of `methods.build` and `config`, whose imports take long
_MAX_TEXT = 200


class Description(NamedTuple):
    """A model without its networks.

    Attributes:
        name: name of the config.
        method: method of the model, "ha2g".
        num_frames: frames of a window, N.
        num_seed_frames: frames of the seed pose, M.
        fps: frames per second.
        style_dim: values of a style.
        has_hidden_ends: whether the model was trained with hidden ends, `config.data.lookahead` > 0.
        weights: form of the weights in the file, see `graph.WEIGHTS`.
        license: licence of the model, "" if it is not known.
        assets: skeleton, speakers and seed poses; without a vocabulary.
    """

    name: str
    method: str
    num_frames: int
    num_seed_frames: int
    fps: int
    style_dim: int
    has_hidden_ends: bool
    weights: str
    license: str
    assets: Assets


_NUMBERS = ("num_frames", "num_seed_frames", "fps", "style_dim")
_TEXTS = ("name", "method", "weights", "license")


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
    texts = {"format": FORMAT, "hash": description.assets.hash}
    texts |= {name: getattr(description, name) for name in _TEXTS}
    return texts | {name: json.dumps(value) for name, value in values.items()}


def from_metadata(metadata: Mapping[str, str]) -> Description:
    """Return the description that `to_metadata` wrote.

    Args:
        metadata: texts by name, of any origin.

    Raises:
        KeyError, TypeError, ValueError, OverflowError: the texts are not a description.
    """
    if metadata.get("format") != FORMAT:
        raise ValueError("not written by ha2g export-onnx, or of another version")
    if sum(map(len, metadata.values())) > MAX_ASSETS_BYTES:
        raise ValueError(f"more than {MAX_ASSETS_BYTES} characters of metadata")
    texts = {name: metadata[name] for name in _TEXTS}
    if any(len(text) > _MAX_TEXT or not text.isprintable() for text in texts.values()):
        raise ValueError("a text of the metadata is too long or cannot be printed")
    values: dict[str, Any] = {
        name: parse_json(metadata[name])
        for name in (*_NUMBERS, "has_hidden_ends", "skeleton", "speakers", "seed_poses")
    }
    numbers = {name: values[name] for name in _NUMBERS}
    if any(type(number) is not int for number in numbers.values()):
        raise TypeError("a size is not a whole number")
    ranges = {
        "num_frames": (MIN_FRAMES, MAX_WINDOW_FRAMES),
        "num_seed_frames": (1, numbers["num_frames"] // 2),
        "fps": (MIN_FPS, MAX_FPS),
        "style_dim": (0, MAX_CHANNELS),
    }
    for name, (least, most) in ranges.items():
        if not least <= numbers[name] <= most:
            raise ValueError(f"{name} is {numbers[name]} instead of {least} to {most}")
    assets = assets_module.from_json(
        {name: values[name] for name in ("skeleton", "speakers", "seed_poses")}
        | {"schema_version": assets_module.SCHEMA_VERSION, "vocabulary": [], "hash": metadata["hash"]}
    )
    assets_module.check_fit(assets, numbers["num_seed_frames"], (numbers["style_dim"],))
    hidden = values["has_hidden_ends"]
    return Description(**texts, **numbers, has_hidden_ends=hidden is True, assets=assets)
