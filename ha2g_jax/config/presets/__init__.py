"""Configs by name, for the data sets, the methods of Table 1 and the ablations of Tables 3, 4 and 11.

presets.make("talk", "small")                                          # HA2G
presets.make("ted_gesture", method="trimodal")                         # a baseline
presets.make("talk", "study", changes=presets.ABLATIONS["Holistic"])   # a row of Table 4
"""

from collections.abc import Mapping
from typing import Any

import ml_collections

from ha2g_jax.config import renames as config_renames
from ha2g_jax.config import settings as configs
from ha2g_jax.config.presets.ablations import ABLATIONS
from ha2g_jax.config.presets.data import DATA
from ha2g_jax.config.presets.methods import METHODS, TUNED
from ha2g_jax.config.settings import Config
from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import shown

__all__ = ["ABLATIONS", "DATA", "METHODS", "make", "parse"]


def make(data: str, size: str = "", method: str = "ha2g", changes: Mapping[str, Any] | None = None) -> Config:
    """Return the config of a method on a kind of data.

    Args:
        data: kind of data, a key of `DATA`.
        size: a key of `config.SIZES`; "" for the size of the paper.
        method: name of the method, a key of `METHODS`.
        changes: dotted name of a setting -> value, such as a row of `ABLATIONS`.

    Raises:
        UserError: a name is unknown.
    """
    for kind, name, names in (("data", data, DATA), ("method", method, METHODS)):
        if name not in names:
            raise UserError(f"no {kind} '{shown(name)}'; expected one of {', '.join(names)}")
    preset = DATA[data]
    config = configs.sized(configs.paper(preset.skeleton), size)
    preset.adapt(config, size)
    METHODS[method](config, size)
    _change(config, TUNED.get(size, {}).get(method, {}))
    _change(config, changes or {})
    return config


def parse(spec: str, method: str) -> Config:
    """Return the config of a method for data and size in one string.

    Args:
        spec: "DATA" or "DATA:SIZE".
        method: name of the method, a key of `METHODS`.

    Raises:
        UserError: a name is unknown.
    """
    data, _, size = spec.partition(":")
    return make(data, size, method)


def _change(config: Config, changes: Mapping[str, Any]) -> None:
    names = {name: config_renames.new_name(name, config.method) for name in changes}
    config_renames.warn([(old, new) for old, new in names.items() if old != new], "the list of changes")
    for name, value in changes.items():
        *path, last = names[name].split(".")
        part: Any = config
        for key in path:
            part = part[key] if isinstance(part, ml_collections.ConfigDict) and key in part else None
        if not isinstance(part, ml_collections.ConfigDict) or last not in part:
            raise UserError(f"no setting {name!r}; see ha2g_jax/config.py")
        try:
            part[last] = value
        except TypeError as error:
            raise UserError(f"{name} cannot be {value!r}; expected a value like {part[last]!r}") from error
