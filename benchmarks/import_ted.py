"""Measure how many hours of speech `ha2g data import` reads in an hour.

python benchmarks/import_ted.py ted_expressive_dataset/train --hours 1 --workers 2

The records of the database are copied into a temporary database, under new keys, until it has that many hours of clips.
The time of its import includes the start of the processes; the import of the original records alone shows how much that
is. The exit code is 1 below 100 hours in an hour.
"""

import argparse
import json
import math
import os
import pathlib
import sys
import tempfile
import time
from collections.abc import Iterator

import lmdb

from ha2g_jax.cli.parser import positive
from ha2g_jax.errors import UserError
from ha2g_jax.importers.ted import arrow, importer

_LEAST_SPEED = 100


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("src", type=pathlib.Path, help="folder of one LMDB database of TED-Expressive or TED-Gesture")
    parser.add_argument("--hours", type=float, default=1.0, help="hours of speech to import (default: 1)")
    parser.add_argument("--workers", type=positive, default=os.cpu_count() or 1)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    try:
        result = measure(arguments.src, arguments.hours, arguments.workers)
    except UserError as error:
        print(f"import_ted: {error}", file=sys.stderr)
        return 2
    print(json.dumps(result, indent=1) if arguments.json else as_text(result))
    return 0 if result["hours_per_hour"] >= _LEAST_SPEED else 1


def measure(src: pathlib.Path, hours: float, workers: int) -> dict[str, float]:
    """Measure the import of the database as it is, and of copies of its records.

    Args:
        src: folder of the database.
        hours: hours of speech to import.
        workers: number of processes.

    Returns:
        Hours and seconds of both imports, and the imported hours in an hour.
    """
    importer.check_whole(src)
    values = [importer.read_value(src, key) for key in importer.read_keys(src)]
    with tempfile.TemporaryDirectory() as folder:
        own_hours, own_seconds = _import(values, 0, pathlib.Path(folder) / "one", workers)
        all_hours, all_seconds = _import(values, hours, pathlib.Path(folder) / "many", workers)
    return {
        "workers": workers,
        "own_hours": own_hours,
        "own_seconds": own_seconds,
        "hours": all_hours,
        "seconds": all_seconds,
        "hours_per_hour": 3600 * all_hours / all_seconds,
    }


def _import(values: list[bytes], hours: float, folder: pathlib.Path, workers: int) -> tuple[float, float]:
    """Make a database, import it, and return the hours of clips and the seconds."""
    src = folder / "lmdb"
    src.mkdir(parents=True)
    copies = list(_copies(values, hours))
    size = sum(len(value) + 8192 for value, _ in copies)
    with lmdb.open(str(src), map_size=2 * size + (1 << 20), lock=False) as database:
        for index, (value, _) in enumerate(copies):
            with database.begin(write=True) as transaction:
                transaction.put(f"{index:010d}".encode(), value)
    start = time.perf_counter()
    importer.import_ted(src, folder / "corpus", workers=workers)
    return sum(hours for _, hours in copies), time.perf_counter() - start


def _copies(values: list[bytes], hours: float) -> Iterator[tuple[bytes, float]]:
    """Yield all records repeatedly, until the hours suffice, with the hours of each record."""
    own_hours = [_hours(value) for value in values]
    if not sum(own_hours):
        raise UserError("no clip in this database; name that of a training split")
    for _ in range(max(1, math.ceil(hours / sum(own_hours)))):
        yield from zip(values, own_hours)


def _hours(value: bytes) -> float:
    clips = arrow.deserialize(value, "a record")["clips"]
    return sum(clip["end_time"] - clip["start_time"] for clip in clips) / 3600


def as_text(result: dict[str, float]) -> str:
    return (
        f"{result['hours']:.2f} h of speech in {result['seconds']:.1f} s with {result['workers']} workers: "
        f"{result['hours_per_hour']:.0f} hours in an hour ({3600 * result['own_hours']:.0f} s of speech alone take "
        f"{result['own_seconds']:.1f} s, most of it to start)"
    )


if __name__ == "__main__":
    sys.exit(main())
