"""The versions of a corpus on disk, and how an older one is read.

The rule: a later version only adds. A record gains fields, each with a default that `records.unpack` puts where an
older record lacks it; `dataset.json` gains entries, which the steps below add in memory when it is read. No file is
ever changed, so an older corpus stays readable by the version that made it. A version that is newer than this one is
refused, because what it added cannot be known here.
"""

from collections.abc import Callable
from typing import Any

VERSION = 2


def upgrade(metadata: dict[str, Any]) -> dict[str, Any]:
    """The contents of a `dataset.json` as the present version has them.

    Args:
        metadata: of any version from 1 to the present one.

    Raises:
        KeyError: of another version.
    """
    while (version := metadata["schema_version"]) != VERSION:
        metadata = {**_STEPS[version](metadata), "schema_version": version + 1}
    return metadata


def _to_2(metadata: dict[str, Any]) -> dict[str, Any]:
    """Version 2: records have the confidence of their poses, `dataset.json` the report of its import."""
    return {"import": {}, **metadata}


_STEPS: dict[int, Callable[[dict[str, Any]], dict[str, Any]]] = {1: _to_2}
