"""The format of `dataset.json`, the description of a corpus: its version, and a check of every entry."""

import collections
import json
import re
import reprlib
from typing import Any

import numpy as np

from ha2g_jax.data.recording import SplitReport
from ha2g_jax.files.reading import reason
from ha2g_jax.skeleton import SKELETONS, load_skeleton

VERSION = 2
TRAIN = "train"

_FILE_NAME = re.compile(r"[\w-][\w.-]*")  # name of a shard, never a path
MIN_FPS, MAX_FPS = 1, 1000  # frames per second
_MAX_SHOWN = 60  # characters of an entry in a message
_SIGNED = ("mean_directions", "mean_pose")  # statistics that may be negative
_STATISTICS = (*_SIGNED, "lengths", "angle_mean", "angle_variance", "angle_change")


def check(metadata: dict[str, Any]) -> None:
    """Check every entry of a `dataset.json` of the present version that a reader uses; its shards lie in its folder.

    Raises:
        KeyError: an entry is missing.
        ValueError: an entry has a wrong type, shape or value; the message names the entry.
    """
    fps, splits = metadata["fps"], metadata["splits"]
    _require(_is_number(fps) and MIN_FPS <= fps <= MAX_FPS, "fps", fps)
    if metadata["skeleton"] not in SKELETONS:
        raise ValueError(f"an unknown skeleton {reprlib.repr(metadata['skeleton'])}, not one of {SKELETONS}")
    _require(_are_names(metadata["speakers"]), "speakers", metadata["speakers"])
    for name in ("splits", "statistics", "words"):
        _require(isinstance(metadata[name], dict), name, metadata[name])
    for word, count in metadata["words"].items():
        _require(_is_count(count) and count > 0, f"words: {word}", count)
    for split, entry in splits.items():
        _require(0 < len(split) <= _MAX_SHOWN and split.isprintable(), "name of a split", split)
        _require(isinstance(entry, dict), split, entry)
        _check_split(split, entry)
    names = [shard["name"] for entry in splits.values() for shard in entry["shards"]]
    twice = [name for name, count in collections.Counter(names).items() if count > 1]
    _require(not twice, "shard in two places", twice)
    trained = splits.get(TRAIN, {}).get("speakers", [])
    if metadata["speakers"][: len(trained)] != trained:
        raise ValueError(f"speakers does not begin with those of {TRAIN!r}")
    statistics(metadata)
    _check_description(metadata)
    json.dumps(metadata, ensure_ascii=False, allow_nan=False).encode()  # every number is finite, every text Unicode


def statistics(metadata: dict[str, Any]) -> dict[str, np.ndarray]:
    """Return the statistics of a `dataset.json` by name of the field of `Skeleton`, float32.

    Raises:
        ValueError: they do not fit the skeleton, or are not finite.
    """
    skeleton, found = load_skeleton(metadata["skeleton"]), {}
    for name, values in metadata["statistics"].items():
        _require(name in _STATISTICS, "name of statistics", name)
        array, shape = np.array(values), getattr(skeleton, name).shape
        if array.shape != shape or array.dtype.kind not in "if":
            raise ValueError(f"statistics: {name} that are not {shape} numbers, as {skeleton.name} has")
        with np.errstate(over="ignore"):
            found[name] = array.astype(np.float32)
        if not np.isfinite(found[name]).all() or (name not in _SIGNED and found[name].min() < 0):
            raise ValueError(f"statistics: {name} with negative or infinite numbers")
    return found


def is_split_name(name: str) -> bool:
    """Return whether a new split may have this name: at most 60 letters, digits, - and _, and no digit first."""
    return name.replace("-", "_").isidentifier() and len(name) <= _MAX_SHOWN


def _check_split(split: str, entry: dict[str, Any]) -> None:
    _require(_is_count(entry["clips"]), f"{split}: clips", entry["clips"])
    _require(_are_names(entry["speakers"]), f"{split}: speakers", entry["speakers"])
    _require(_is_count(entry["windows"]), f"{split}: windows", entry["windows"])
    seconds = entry["seconds"]
    _require(_is_number(seconds) and 0 <= seconds < 2**63, f"{split}: seconds", seconds)
    _require(_is_list_of_dicts(entry["shards"]), f"{split}: shards", entry["shards"])
    for shard in entry["shards"]:
        name, digest = shard["name"], shard["sha256"]
        _require(isinstance(name, str) and _FILE_NAME.fullmatch(name) is not None, f"{split}: shard", name)
        _require(_is_count(shard["bytes"]), f"{split}: bytes of {name}", shard["bytes"])
        _require(isinstance(digest, str), f"{split}: sha256 of {name}", digest)


def _check_description(metadata: dict[str, Any]) -> None:
    """Check the entries on the origin of the data, and those of the corpora that were merged."""
    report = metadata.get("import", {})
    _require(isinstance(report, dict), "import", report)
    for split, counts in report.items():
        try:
            SplitReport.from_json(counts)
        except (TypeError, ValueError, AttributeError) as error:
            raise ValueError(f"a damaged import report of {repr(split)[:_MAX_SHOWN]}: {reason(error)}") from error
    _require(_is_list_of_dicts(metadata.get("failed", [])), "failed", metadata.get("failed"))
    video = metadata.get("video", {})
    _require(isinstance(video, dict) and isinstance(video.get("settings", {}), dict), "video", video)
    confidence = video.get("settings", {}).get("min_confidence", 0)
    _require(_is_number(confidence), "video: settings: min_confidence", confidence)
    _require(_is_list_of_dicts(metadata.get("merged", [])), "merged", metadata.get("merged"))
    for part in metadata.get("merged", []):
        _check_description(part)


def _require(is_right: bool, entry: str, found: object) -> None:
    if not is_right:
        raise ValueError(f"{repr(entry[:_MAX_SHOWN])[1:-1]} is {reprlib.repr(found)[:_MAX_SHOWN]}")


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _is_count(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 2**63


def _are_names(value: object) -> bool:
    return isinstance(value, list) and all(isinstance(name, str) for name in value) and len(set(value)) == len(value)


def _is_list_of_dicts(value: object) -> bool:
    return isinstance(value, list) and all(isinstance(item, dict) for item in value)
