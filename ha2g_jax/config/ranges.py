"""Check the settings that networks are built from: present, of the right type, and of a size that can work.

A config may come with a model from elsewhere, and building must neither fail in the middle nor take for ever. Settings
whose value is one of a few names are checked where they are used, see `choices`.
"""

import reprlib
from collections.abc import Callable
from typing import Any

import ml_collections

from ha2g_jax.config.settings import Config
from ha2g_jax.errors import UserError
from ha2g_jax.limits import (
    MAX_CHANNELS,
    MAX_IMAGE_SIZE,
    MAX_LAYERS,
    MAX_REFERENCE_IMAGES,
    MAX_TEXT_LAYERS,
    MAX_WHISPER_LAYERS,
)

_ANY = 10**12

# What is expected, and whether a value is so.
Range = tuple[str, Callable[[Any], bool]]


def _is_whole(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _whole(least: int, most: int) -> Range:
    return f"a whole number from {least} to {most}", lambda value: _is_whole(value) and least <= value <= most


def _several(item: Range, count: int | None = None) -> Range:
    expected, is_met = item
    number = f"a list of {count}, each " if count else f"a list of at most {MAX_LAYERS}, each "
    return (
        number + expected,
        lambda values: (
            isinstance(values, list | tuple)
            and (len(values) == count if count else len(values) <= MAX_LAYERS)
            and all(map(is_met, values))
        ),
    )


# Their ranges depend on other settings and are checked by `build`.
_ANY_WHOLE: Range = ("a whole number", lambda value: _is_whole(value) and abs(value) < _ANY)
_RATE: Range = ("a number", lambda value: isinstance(value, int | float) and abs(value) < _ANY)
_FRACTION: Range = (
    "a number from 0 to 1",
    lambda value: isinstance(value, int | float) and not isinstance(value, bool) and 0 <= value <= 1,
)
_FLAG: Range = ("True or False", lambda value: isinstance(value, bool))
_TEXT: Range = ("a text", lambda value: isinstance(value, str))
_SIZE = _whole(1, MAX_CHANNELS)
_LAYERS = _whole(1, MAX_LAYERS)

# Of the audio network: squeeze and excitation divides channels by 8, the pixel shuffles before the heads by 4 and 16.
_STAGE_CHANNELS: Range = (
    f"four whole numbers from 8 to {MAX_CHANNELS}, the third a multiple of 4, the fourth of 16",
    lambda values: _several(_whole(8, MAX_CHANNELS), 4)[1](values) and values[2] % 4 == 0 and values[3] % 16 == 0,
)
# Four stages halve the 128 frequencies three times, and the kernels of the heads are up to 3 wide.
_STEM_STRIDE: Range = (
    "(1 to 16, 1)",
    lambda values: _several(_ANY_WHOLE, 2)[1](values) and 1 <= values[0] <= 16 and values[1] == 1,
)
_STAGES: Range = (
    f"1 to {MAX_LAYERS} whole numbers from 1 to {MAX_CHANNELS}",
    lambda values: _several(_SIZE)[1](values) and len(values) > 0,
)
_HIDDEN: Range = (f"a whole number from 2 to {MAX_CHANNELS}", _whole(2, MAX_CHANNELS)[1])  # half of it is a width too

_RANGES: dict[str, Range] = {
    "name": _TEXT,
    "method": _TEXT,
    "data.path": _TEXT,
    "data.num_frames": _ANY_WHOLE,  # `build` knows the limits of windows
    "data.num_seed_frames": _ANY_WHOLE,
    "data.fps": _RATE,
    "data.num_reference_images": _whole(1, MAX_REFERENCE_IMAGES),
    "data.image_size": _whole(1, MAX_IMAGE_SIZE),
    "data.mirror": _FRACTION,
    "model.architecture": _TEXT,
    "model.recompute": _FLAG,
    "model.audio.kind": _TEXT,
    "model.audio.feature_dim": _SIZE,
    "model.audio.levels": _several(_TEXT),
    "model.audio.resnet_se.blocks": _several(_LAYERS, 4),
    "model.audio.resnet_se.channels": _STAGE_CHANNELS,
    "model.audio.resnet_se.stem_stride": _STEM_STRIDE,
    "model.audio.whisper.num_mels": _SIZE,
    "model.audio.whisper.d_model": _whole(4, MAX_CHANNELS),
    "model.audio.whisper.layers": _whole(1, MAX_WHISPER_LAYERS),
    "model.audio.whisper.heads": _SIZE,
    "model.audio.whisper.ffn_dim": _SIZE,
    "model.text.embedding_dim": _SIZE,
    "model.text.channels": _SIZE,
    "model.text.layers": _whole(1, MAX_TEXT_LAYERS),
    "model.text.receptive_field": _TEXT,
    "model.text.dropout": _FRACTION,
    "model.identity.kind": _TEXT,
    "model.identity.feature_dim": _SIZE,
    "model.identity.images.blocks": _several(_LAYERS, 4),
    "model.identity.images.width": _SIZE,
    "model.inferer.levels": _several(_ANY_WHOLE),
    "model.inferer.coordinator": _TEXT,
    "model.inferer.hidden_dim": _HIDDEN,
    "model.inferer.layers": _LAYERS,
    "model.inferer.dropout": _FRACTION,
    "model.discriminator.hidden_dim": _SIZE,
    "model.discriminator.layers": _LAYERS,
}
# Settings that only one method has.
_OF_METHOD: dict[str, dict[str, Range]] = {
    "speech2gesture": {"model.legacy": _FLAG, "model.audio.spectrogram.channels": _STAGES},
    "joint_embedding": {"model.context.hidden_dim": _HIDDEN, "model.context.layers": _LAYERS},
}
# Settings that may be left out.
_OPTIONAL: dict[str, Range] = {"model.discriminator.dropout": _FRACTION}
# Parts that become the fields of a module as they are.
_WHOLE_PARTS = ("model.audio.resnet_se", "model.audio.whisper", "model.identity.images", "model.discriminator")


def check_ranges(config: Config) -> None:
    """Check the types and sizes of `config.data` and `config.model`.

    Args:
        config: settings of a model.

    Raises:
        UserError: a setting is missing, unknown, of another type or outside its range.
    """
    method = _value(config, "method")
    ranges = _RANGES | _OF_METHOD.get(method if isinstance(method, str) else "", {})
    for name, (expected, is_met) in ranges.items():
        _check(name, _value(config, name), expected, is_met)
    for name, (expected, is_met) in _OPTIONAL.items():
        if _value(config, name) is not None:
            _check(name, _value(config, name), expected, is_met)
    for part in _WHOLE_PARTS:
        if unknown := [key for key in _value(config, part) if f"{part}.{key}" not in ranges | _OPTIONAL]:
            raise UserError(f"unknown setting config.{part}.{reprlib.repr(unknown[0])}; see ha2g_jax/config.py")
    whisper = config.model.audio.whisper
    if whisper.d_model % whisper.heads or whisper.d_model % 2:
        _check("model.audio.whisper.d_model", whisper.d_model, "an even multiple of the heads", lambda _: False)


def _value(config: Config, name: str) -> Any:
    """Return the value of a setting by its dotted name, None if there is none."""
    value = config
    for key in name.split("."):
        value = value.get(key) if isinstance(value, ml_collections.ConfigDict) else None
    return value


def _check(name: str, value: Any, expected: str, is_met: Callable[[Any], bool]) -> None:
    if value is None:
        raise UserError(f"config.{name} is missing, expected {expected}: set --config.{name}")
    if not is_met(value):
        raise UserError(f"config.{name} is {reprlib.repr(value)}, expected {expected}: set --config.{name}")
