"""Map the tensors of a released file to our variables: each is used exactly once, and what does not fit is an error."""

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from ha2g_jax.checkpoint.released.table import Row

# Entries without a place: counters of batches, the linear map of a variance that is never used, and second names of the
# convolutions of a text encoder.
_COUNTERS = re.compile(r"(.*\.)?num_batches_tracked")
_UNUSED = re.compile(r"pose_encoder\.fc_logvar\.(weight|bias)")
_SECOND_NAME = re.compile(r"(.*tcn\.network\.\d+\.)net\.([04])(\..*)")
_FIRST_NAMES = {"0": "conv1", "4": "conv2"}

Parts = Mapping[str, Mapping[str, Any]]


class DoesNotFitError(ValueError):
    """Error for a file whose entries are not those of the table."""


def check_names(parts: Parts, rows: Sequence[Row]) -> None:
    """Check that a file has the tensors of the table and no others.

    Args:
        parts: values by name, for each key of the file that rows name.
        rows: the table.

    Raises:
        DoesNotFitError: an entry is missing, no tensor, or unknown.
    """
    missing = [row for row in rows if not isinstance(parts.get(row.part, {}).get(row.name), np.ndarray)]
    if missing:
        more = f" and {len(missing) - 1} more" if missing[1:] else ""
        raise DoesNotFitError(f"no tensor {_shown(missing[0].part, missing[0].name)}{more}")
    odd = [(part, name) for part, name in left_out(parts, rows) if not _may_be_left_out(parts[part], str(name))]
    if odd:
        more = f" and {len(odd) - 1} more" if odd[1:] else ""
        raise DoesNotFitError(f"{_shown(*odd[0])}{more} is in no row of the table (docs/released_weights.md)")


def convert(parts: Parts, rows: Sequence[Row], shapes: Mapping[str, tuple[int, ...]]) -> dict[str, np.ndarray]:
    """Convert the tensors of a file whose names were checked.

    Args:
        parts: arrays by name, for each key of the file that rows name.
        rows: the table.
        shapes: shape of each of our variables, by name.

    Returns:
        Float32 arrays by the names of `shapes`.

    Raises:
        DoesNotFitError: an entry is of another shape or type, or has values that are not finite.
    """
    targets = [row.target for row in rows]
    if len(set(targets)) != len(targets) or set(targets) != set(shapes):
        raise ValueError(f"the table and the networks differ in {sorted(set(targets) ^ set(shapes))[:3]}")
    converted = {}
    for row in rows:
        array, expected = parts[row.part][row.name], row.conversion.stored(shapes[row.target])
        if array.shape != expected:
            raise DoesNotFitError(f"{_shown(row.part, row.name)} has shape {array.shape}, expected {expected}")
        if array.dtype.kind != "f":
            raise DoesNotFitError(f"{_shown(row.part, row.name)} has numbers of type {array.dtype}, expected floats")
        # A view of the file stays one where nothing changes; writers other than PyTorch do not align the numbers.
        values = np.require(row.conversion.convert(array), np.float32, ("C_CONTIGUOUS", "ALIGNED"))
        if not np.isfinite(values).all():
            raise DoesNotFitError(f"{_shown(row.part, row.name)} has values that are not finite")
        converted[row.target] = values
    return converted


def left_out(parts: Parts, rows: Iterable[Row]) -> list[tuple[str, str]]:
    """Return (part, name) of the entries that have no row."""
    wanted = {(row.part, row.name) for row in rows}
    return [(part, name) for part, entries in parts.items() for name in entries if (part, name) not in wanted]


def _may_be_left_out(entries: Mapping[str, Any], name: str) -> bool:
    if _COUNTERS.fullmatch(name) or _UNUSED.fullmatch(name):
        return True
    if not (match := _SECOND_NAME.fullmatch(name)):
        return False
    first, second = entries.get(f"{match[1]}{_FIRST_NAMES[match[2]]}{match[3]}"), entries[name]
    return isinstance(first, np.ndarray) and isinstance(second, np.ndarray) and np.array_equal(first, second)


def _shown(part: str, name: Any) -> str:
    return repr(f"{part}: {str(name)[:100]}")
