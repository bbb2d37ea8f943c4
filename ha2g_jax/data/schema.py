"""Versions of the format of a corpus on disk, and conversion of older versions when they are read.

A later version only adds. A record gains fields, each with a default that `records.unpack` fills in for an older
record; `dataset.json` gains entries, which the steps below add in memory when it is read. No file is ever changed, so
an older corpus stays readable by the version that made it. A newer version than this one is refused, because its
additions are unknown here.
"""

import re
from collections.abc import Callable
from typing import Any

VERSION = 2

_FILE_NAME = re.compile(r"[\w-][\w.-]*")  # name of a shard, never a path
_MIN_FPS, _MAX_FPS = 1, 1000
_MAX_SHOWN = 60  # characters of an entry in a message


def upgrade(metadata: dict[str, Any]) -> dict[str, Any]:
    """Convert the contents of a `dataset.json` to the present version.

    Args:
        metadata: contents of any version from 1 to the present one.

    Returns:
        Contents of the present version.

    Raises:
        KeyError: the version is unknown.
    """
    while (version := metadata["schema_version"]) != VERSION:
        metadata = {**_STEPS[version](metadata), "schema_version": version + 1}
    return metadata


def check(metadata: dict[str, Any]) -> None:
    """Check the types of the entries of a `dataset.json` that a reader uses, and that its shards lie in its folder.

    Args:
        metadata: contents of the present version.

    Raises:
        KeyError: an entry is missing.
        ValueError: an entry has a wrong type or value; the message names the entry.
    """
    fps = metadata["fps"]
    _require(isinstance(fps, int | float) and _MIN_FPS <= fps <= _MAX_FPS, "fps", fps)
    _require(isinstance(metadata["speakers"], list), "speakers", metadata["speakers"])
    for name in ("splits", "statistics", "words"):
        _require(isinstance(metadata[name], dict), name, metadata[name])
    for word, count in metadata["words"].items():
        _require(_is_count(count) and count > 0, f"words: {word}", count)
    for split, entry in metadata["splits"].items():
        _require(isinstance(entry, dict), split, entry)
        _require(_is_count(entry["clips"]), f"{split}: clips", entry["clips"])
        _require(isinstance(entry.get("speakers", []), list), f"{split}: speakers", entry.get("speakers"))
        _require(_is_list_of_dicts(entry["shards"]), f"{split}: shards", entry["shards"])
        for shard in entry["shards"]:
            name = shard["name"]
            _require(isinstance(name, str) and _FILE_NAME.fullmatch(name) is not None, f"{split}: shard", name)
            _require(_is_count(shard["bytes"]), f"{split}: bytes of {name}", shard["bytes"])
    _require(isinstance(metadata.get("import", {}), dict), "import", metadata.get("import"))
    _require(_is_list_of_dicts(metadata.get("failed", [])), "failed", metadata.get("failed"))
    video = metadata.get("video", {})
    _require(isinstance(video, dict) and isinstance(video.get("settings", {}), dict), "video", video)


def _require(is_right: bool, entry: str, found: object) -> None:
    if not is_right:
        raise ValueError(f"{entry[:_MAX_SHOWN]} is {repr(found)[:_MAX_SHOWN]}")


def _is_count(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0


def _is_list_of_dicts(value: object) -> bool:
    return isinstance(value, list) and all(isinstance(item, dict) for item in value)


def _to_2(metadata: dict[str, Any]) -> dict[str, Any]:
    """Convert to version 2: records have the confidence of their poses, `dataset.json` has the report of its import."""
    return {"import": {}, **metadata}


_STEPS: dict[int, Callable[[dict[str, Any]], dict[str, Any]]] = {1: _to_2}
