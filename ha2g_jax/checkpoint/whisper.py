"""Read the encoder of Whisper from a Hugging Face folder: config.json and model.safetensors, in one file or in shards.

Only the tensors of the encoder are read, so that the folder need not contain the decoder. Their names are those of
`transformers`, with or without the prefix "model.".
"""

import math
import pathlib
import reprlib
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import traverse_util

from ha2g_jax.errors import UserError
from ha2g_jax.features.spectrum import asr_columns
from ha2g_jax.files.reading import parse_json, read_bytes, reading, reason, shown
from ha2g_jax.files.tensors import open_tensors, read_tensor
from ha2g_jax.layers.whisper import WhisperEncoder, sinusoids
from ha2g_jax.limits import MAX_CHANNELS, MAX_CONFIG_BYTES, MAX_HEADER_BYTES, MAX_WHISPER_BYTES, MAX_WHISPER_LAYERS

CONFIG, WEIGHTS, INDEX = "config.json", "model.safetensors", "model.safetensors.index.json"

_PREFIXES = ("model.encoder.", "encoder.")
_POSITIONS = "embed_positions.weight"
# Names of the parts of a block in this package -> in `transformers`.
_PARTS = {
    "attention_norm": "self_attn_layer_norm",
    "attention/query": "self_attn.q_proj",
    "attention/key": "self_attn.k_proj",
    "attention/value": "self_attn.v_proj",
    "attention/out": "self_attn.out_proj",
    "mlp_norm": "final_layer_norm",
    "expand": "fc1",
    "contract": "fc2",
}
_ENDS = {"conv_1": "conv1", "conv_2": "conv2", "norm": "layer_norm"}
_KINDS = {"kernel": "weight", "scale": "weight", "bias": "bias"}
_MAX_POSITIONS = 100_000  # Whisper has 1,500
_POSITION_TOLERANCE = 0.01  # the error of bfloat16 is 0.004


class WhisperSizes(NamedTuple):
    """Fields of `WhisperEncoder`."""

    num_mels: int
    d_model: int
    layers: int
    heads: int
    ffn_dim: int


# Names of the fields in config.json, in the same order, and their limits.
_FIELDS = {
    "num_mel_bins": MAX_CHANNELS,
    "d_model": MAX_CHANNELS,
    "encoder_layers": MAX_WHISPER_LAYERS,
    "encoder_attention_heads": MAX_CHANNELS,
    "encoder_ffn_dim": MAX_CHANNELS,
}


def load(folder: str | pathlib.Path) -> tuple[WhisperSizes, dict[str, Any]]:
    """Read the encoder of a Whisper model from its folder, with weights in float16, bfloat16 or float32.

    Returns:
        The sizes, and the parameters of `WhisperEncoder(**sizes._asdict())` as float32 numpy arrays.

    Raises:
        UserError: a file or a tensor is missing or damaged, or is not that of a Whisper model.
    """
    folder = pathlib.Path(folder)
    sizes = read_sizes(folder)
    places = _places(folder)
    # Kernels are (..., inputs, outputs) here and (outputs, inputs, ...) there.
    shapes = {name: shape[::-1] for name, shape in _parameters(sizes).items()}
    if (num_bytes := 2 * sum(map(math.prod, shapes.values()))) > MAX_WHISPER_BYTES:
        raise UserError(
            f"the encoder of {shown(folder)} has {num_bytes} bytes in 16 bits, expected at most {MAX_WHISPER_BYTES}; "
            "choose a smaller Whisper model"
        )
    params = {}
    for name, shape in shapes.items():
        place = places.get(_their_name(name))
        if place is None:
            raise UserError(
                f"{shown(folder)} has no tensor {_PREFIXES[0]}{_their_name(name)}, which {CONFIG} asks for; "
                "download all of the model again"
            )
        params[name] = np.ascontiguousarray(_read(place, shape).T)
    if _POSITIONS in places:
        _check_positions(places[_POSITIONS], sizes.d_model)
    return sizes, traverse_util.unflatten_dict(params, sep="/")


def read_sizes(folder: str | pathlib.Path) -> WhisperSizes:
    """Read the sizes of the encoder, without the weights.

    Raises:
        UserError: there is no config.json, or it is not that of a Whisper model.
    """
    path = pathlib.Path(folder) / CONFIG
    config = _read_json(path, MAX_CONFIG_BYTES)
    kind, activation = config.get("model_type"), config.get("activation_function", "gelu")
    if kind != "whisper" or activation != "gelu":
        field, value = ("model_type", kind) if kind != "whisper" else ("activation_function", activation)
        raise UserError(
            f"{shown(path)} has {field} {reprlib.repr(value)}; expected a Whisper model ('whisper', 'gelu'), such as "
            "whisper-tiny.en"
        )
    for field, most in _FIELDS.items():
        if type(config.get(field)) is not int or not 1 <= config[field] <= most:
            raise UserError(
                f"{shown(path)} has {field} {reprlib.repr(config.get(field))}; expected a whole number from 1 to "
                f"{most}, as a Whisper model has"
            )
    sizes = WhisperSizes(*(config[field] for field in _FIELDS))
    if sizes.d_model % sizes.heads or sizes.d_model % 2 or sizes.d_model < 4:
        raise UserError(
            f"{shown(path)} has d_model {sizes.d_model} and {sizes.heads} encoder_attention_heads; "
            "expected an even multiple of the heads, at least 4"
        )
    return sizes


def _read_json(path: pathlib.Path, max_bytes: int) -> dict[str, Any]:
    with reading(path, "a JSON file of a Whisper model"):
        exists = path.is_file()
    if not exists:
        raise UserError(
            f"no file {shown(path)}; expected a folder with {CONFIG} and {WEIGHTS}, as Hugging Face has Whisper models"
        )
    content = read_bytes(path, "a JSON file of a Whisper model", max_bytes)
    try:
        values = parse_json(content)
    except ValueError as error:
        raise UserError(f"{shown(path)} is damaged ({reason(error)}); download it again") from error
    if not isinstance(values, dict):
        raise UserError(f"{shown(path)} is damaged (not a JSON object); download it again")
    return values


class _Place(NamedTuple):
    path: pathlib.Path
    name: str  # of the tensor in the file


def _places(folder: pathlib.Path) -> dict[str, _Place]:
    """Return name of each tensor of the encoder, without prefix -> file and full name."""
    if (folder / WEIGHTS).is_file():
        with open_tensors(folder / WEIGHTS) as file:
            shards = dict.fromkeys(file.keys(), WEIGHTS)
    elif (folder / INDEX).is_file():
        shards = _read_json(folder / INDEX, MAX_HEADER_BYTES).get("weight_map")
        if not isinstance(shards, dict) or not all(_is_file_name(shard) for shard in shards.values()):
            raise UserError(
                f"{shown(folder / INDEX)} has no weight_map from tensors to files beside it; download it again"
            )
    else:
        raise UserError(
            f"no {WEIGHTS} in {shown(folder)}; expected a Whisper model as Hugging Face has it, in the form of "
            "safetensors"
        )
    places = {}
    for name, shard in shards.items():
        for prefix in _PREFIXES:
            if name.startswith(prefix):
                places[name.removeprefix(prefix)] = _Place(folder / shard, name)
    return places


def _is_file_name(name: Any) -> bool:
    return isinstance(name, str) and pathlib.PurePath(name).name == name


def _parameters(sizes: WhisperSizes) -> dict[str, tuple[int, ...]]:
    """Return the shape of each parameter of the encoder by its name, such as "block_0/expand/kernel"."""
    mel = jnp.zeros((1, sizes.num_mels, asr_columns(34, 15)), jnp.float32)
    shapes = jax.eval_shape(lambda: WhisperEncoder(**sizes._asdict()).init(jax.random.key(0), mel))
    flat: dict[str, Any] = dict(traverse_util.flatten_dict(shapes["params"], sep="/"))
    return {name: leaf.shape for name, leaf in flat.items()}


def _their_name(name: str) -> str:
    """Return the name of a parameter in `transformers`, without prefix."""
    part, kind = name.rsplit("/", 1)
    block, _, rest = part.partition("/")
    theirs = f"layers.{block.removeprefix('block_')}.{_PARTS[rest]}" if rest else _ENDS[part]
    return f"{theirs}.{_KINDS[kind]}"


def _read(place: _Place, shape: tuple[int, ...]) -> np.ndarray:
    """Read a tensor as float32 after its shape was checked."""
    with open_tensors(place.path) as file:
        found = _shape(file, place)
        if found != shape:
            raise UserError(
                f"{shown(place.path)} has {place.name} of shape {found}, expected {shape} from {CONFIG}: "
                "the files belong to two models; download them again"
            )
        return read_tensor(file, place.name, place.path)


def _shape(file: Any, place: _Place) -> tuple[int, ...]:
    return tuple(file.get_slice(place.name).get_shape())


def _check_positions(place: _Place, channels: int) -> None:
    """Check that the positions, which are not parameters of `WhisperEncoder`, are Whisper's sinusoids."""
    with open_tensors(place.path) as file:
        shape = _shape(file, place)
        positions = None
        if len(shape) == 2 and shape[0] <= _MAX_POSITIONS and shape[1] == channels:
            positions = read_tensor(file, place.name, place.path)
    if (
        positions is None
        or np.max(np.abs(positions - sinusoids(len(positions), channels)), initial=0) > _POSITION_TOLERANCE
    ):
        raise UserError(
            f"{shown(place.path)} has positions in {place.name} that are not Whisper's sinusoids; "
            "choose a model whose positions were not trained"
        )
