"""Time the train step of a config in several variants, alternating in one process, so that other load affects all.

python benchmarks/train_step.py --config talk:small --dtype float32 bfloat16
python benchmarks/train_step.py --config talk:small --accumulate 1 4
python benchmarks/train_step.py --config talk:small --devices 1 0

The data are random; their numbers of words and speakers are about those of TED. Several lists of values give all
combinations as variants; ratios are relative to the first variant.
"""

import argparse
import copy
import itertools
import json
import statistics
import sys

from ha2g_jax import launch
from ha2g_jax.errors import UserError
from ha2g_jax.train.machine import gib
from ha2g_jax.train.measure import TimedStep

_SETTINGS = ("batch_size", "dtype", "accumulate", "devices")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--config", required=True, help="FILE[:SIZE]")
    parser.add_argument("--batch-size", type=int, nargs="+", metavar="B")
    parser.add_argument("--dtype", nargs="+", choices=("float32", "bfloat16"))
    parser.add_argument("--accumulate", type=int, nargs="+", metavar="PARTS")
    parser.add_argument("--devices", type=int, nargs="+", metavar="N", help="0 for all")
    parser.add_argument(
        "--steps", type=int, default=10, help="timed steps of each variant, after the first (default: 10)"
    )
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    try:
        rows = measure(launch.load_config(arguments.config), arguments)
    except UserError as error:
        print(f"train_step: {error}", file=sys.stderr)
        return 2
    print(json.dumps(rows, indent=1) if arguments.json else as_table(rows))
    return 0


def measure(config, arguments: argparse.Namespace) -> list[dict]:
    """Time all variants.

    Args:
        config: config of the train step.
        arguments: arguments of the script.

    Returns:
        One row for each variant with its settings, medians and memory.
    """
    values = [getattr(arguments, name) or [config.train[name]] for name in _SETTINGS]
    variants = [dict(zip(_SETTINGS, choice, strict=True)) for choice in itertools.product(*values)]
    steps = []
    for variant in variants:
        print("compiling", variant, file=sys.stderr)
        settings = copy.deepcopy(config)
        settings.train.update(variant)
        steps.append(TimedStep(settings))
    for step in steps:
        step.run()
    seconds: list[list[float]] = [[] for _ in steps]
    for _ in range(arguments.steps):
        for step, times in zip(steps, seconds, strict=True):
            times.append(step.run())
    medians = [statistics.median(times) for times in seconds]
    return [
        variant
        | {
            "devices": step.num_devices,
            "compile_seconds": step.compile_seconds,
            "step_seconds": median,
            "windows_per_second": step.batch_size / median,
            "speed": medians[0] / median * step.batch_size / steps[0].batch_size,
            "memory": step.memory and step.memory._asdict() | {"total": step.memory.total},
        }
        for variant, step, median in zip(variants, steps, medians, strict=True)
    ]


def as_table(rows: list[dict]) -> str:
    header = (*_SETTINGS, "compile s", "step s", "windows/s", "speed", "memory a device")
    cells = [
        (
            *(str(row[name]) for name in _SETTINGS),
            f"{row['compile_seconds']:.1f}",
            f"{row['step_seconds']:.4f}",
            f"{row['windows_per_second']:.1f}",
            f"{row['speed']:.2f}",
            gib(row["memory"]["total"]) if row["memory"] else "",
        )
        for row in rows
    ]
    widths = [max(map(len, column)) for column in zip(header, *cells, strict=True)]
    return "\n".join("  ".join(cell.rjust(width) for cell, width in zip(line, widths)) for line in (header, *cells))


if __name__ == "__main__":
    sys.exit(main())
