"""Time the train step of a config in several variants, alternating in one process, so that other load affects all.

python benchmarks/train_step.py --config talk:small --dtype float32 bfloat16
python benchmarks/train_step.py --config talk:small --accumulate 1 4
python benchmarks/train_step.py --config talk:small --devices 1 0
python benchmarks/train_step.py --config ted_gesture --batch-size 32 --against torch

The data are random; their numbers of words and speakers are about those of TED. Several lists of values give all
combinations as variants; the speed is relative to the first variant.

With `--against torch` there is one variant, and the step of `torch_peer`, in a process of its own, takes turns with
ours, on the same batch and as many threads as there are cores; both keep the memory of a step. On a GPU both multiply
in TensorFloat-32. Where the extra `onednn` is installed, the last two rows are our step without it and with it. The
ratio of a row is its seconds over those of the last one: above 1 the last one is faster.
"""

import argparse
import contextlib
import copy
import functools
import importlib.metadata
import importlib.util
import itertools
import json
import os
import statistics
import sys
from collections.abc import Callable, Sequence
from typing import Any

import jax

from ha2g_jax import launch
from ha2g_jax.cli.parser import positive
from ha2g_jax.config.settings import Config
from ha2g_jax.errors import UserError
from ha2g_jax.layers.cpu.memory import keep_memory
from ha2g_jax.layers.cpu.onednn.library import used_version
from ha2g_jax.train.measure import TimedStep, gib

_SETTINGS = ("batch_size", "dtype", "accumulate", "devices")
# Backend of JAX -> device on which PyTorch runs the same step.
_TORCH_DEVICES = {"cpu": "cpu", "gpu": "cuda"}
_COUNTS = {1: "one pass", 3: "three passes"}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--config", required=True, help="FILE[:SIZE]")
    parser.add_argument("--batch-size", type=positive, nargs="+", metavar="B")
    parser.add_argument("--dtype", nargs="+", choices=("float32", "bfloat16"))
    parser.add_argument("--accumulate", type=positive, nargs="+", metavar="PARTS")
    parser.add_argument("--devices", type=int, nargs="+", metavar="N", help="0 for all")
    parser.add_argument(
        "--steps", type=positive, default=10, help="timed steps of each variant, after the first (default: 10)"
    )
    parser.add_argument("--against", choices=("torch",), help="also time the step of another framework")
    parser.add_argument("--compiled", action="store_true", help="with --against: add the step with torch.compile")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    try:
        config = launch.load_config(arguments.config)
        rows = compare(config, arguments) if arguments.against else measure(config, arguments)
    except UserError as error:
        print(f"train_step: {error}", file=sys.stderr)
        return 2
    table = comparison_table if arguments.against else as_table
    print(json.dumps(rows, indent=1) if arguments.json else table(rows))
    return 0


def measure(config, arguments: argparse.Namespace) -> list[dict]:
    """Time all variants.

    Args:
        config: config of the train step.
        arguments: arguments of the script.

    Returns:
        One row for each variant with its settings, medians and memory.
    """
    variants = settings_of_variants(config, arguments)
    steps = []
    for variant in variants:
        print("compiling", variant, file=sys.stderr)
        settings = copy.deepcopy(config)
        settings.train.update(variant)
        steps.append(TimedStep(settings))
    medians = in_turns([step.run for step in steps], arguments.steps)
    return [
        variant
        | {
            "devices": step.num_devices,
            "compile_seconds": step.compile_seconds,
            "step_seconds": median,
            "windows_per_second": step.batch_size / median,
            "tflops": step.operations / median / 1e12,
            "speed": medians[0] / median * step.batch_size / steps[0].batch_size,
            "memory": step.memory and step.memory._asdict() | {"total": step.memory.total},
        }
        for variant, step, median in zip(variants, steps, medians, strict=True)
    ]


def compare(config: Config, arguments: argparse.Namespace) -> list[dict]:
    """Time our step and those of PyTorch.

    Args:
        config: config of the train step.
        arguments: arguments of the script.

    Returns:
        One row for each step of PyTorch, the published one first, and for ours, with medians and ratios; the last row
        is ours as `ha2g train` runs it, with oneDNN where that is installed.

    Raises:
        UserError: PyTorch is not installed, JAX computes on an accelerator other than a GPU, or PyTorch has no step for
            the config.
    """
    if importlib.util.find_spec("torch") is None:
        raise UserError("PyTorch is not installed; install the extra: pip install 'ha2g-jax[torch]'")
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")  # the memory of a GPU is shared with PyTorch
    device = _TORCH_DEVICES.get(jax.default_backend())
    if device is None:
        raise UserError(f"JAX computes on {jax.default_backend()}, where PyTorch has no step; set JAX_PLATFORMS=cpu")
    variants = settings_of_variants(config, arguments)
    if len(variants) > 1:
        raise UserError(f"--against compares one variant, not {len(variants)}; give each setting one value")
    config = copy.deepcopy(config)
    config.train.update(variants[0])

    import torch_peer

    torch_peer.check(config)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    print("compiling", variants[0], file=sys.stderr)
    with jax.default_matmul_precision("tensorfloat32") if device == "cuda" else contextlib.nullcontext():
        ours = {"ha2g_jax, one pass": TimedStep(config, onednn=False)}
        if used_version():
            ours = {"ha2g_jax, one pass, oneDNN": TimedStep(config)} | ours
    first = next(iter(ours.values()))
    if device == "cuda" and first.num_devices > 1:
        raise UserError(f"our step runs on {first.num_devices} GPUs, that of PyTorch on one; give --devices 1")
    choices = [torch_peer.Choice(3, False), torch_peer.Choice(1, False)]
    choices += [torch_peer.Choice(1, True)] * arguments.compiled
    with contextlib.closing(torch_peer.TorchProcess(config, choices, cores, device)) as process:
        theirs = [functools.partial(process.run, number) for number in range(len(choices))]
        medians = in_turns([*(step.run for step in ours.values()), *theirs], arguments.steps)
    version = importlib.metadata.version("torch")
    names = [
        *ours,
        *(
            f"PyTorch {version}, {'compiled' if choice.compiled else 'eager'}, {_COUNTS[choice.passes]}"
            for choice in choices
        ),
    ]
    rows = [
        {
            "step": name,
            "ratio": median / medians[0],
            "step_seconds": median,
            "windows_per_second": first.batch_size / median,
            "batch_size": first.batch_size,
            "device": jax.devices()[0].device_kind,
            "threads": cores,
        }
        for name, median in zip(names, medians, strict=True)
    ]
    return [*rows[len(ours) :], *reversed(rows[: len(ours)])]


def settings_of_variants(config: Config, arguments: argparse.Namespace) -> list[dict[str, Any]]:
    """Return all combinations of the values that the arguments give, or else the config."""
    values = [getattr(arguments, name) or [config.train[name]] for name in _SETTINGS]
    return [dict(zip(_SETTINGS, choice, strict=True)) for choice in itertools.product(*values)]


def in_turns(steps: Sequence[Callable[[], float]], rounds: int) -> list[float]:
    """Call each step once, then all in turns, and return the median of the seconds that each returns."""
    for step in steps:
        step()
    seconds: list[list[float]] = [[] for _ in steps]
    for _ in range(rounds):
        for step, times in zip(steps, seconds, strict=True):
            times.append(step())
    return [statistics.median(times) for times in seconds]


def comparison_table(rows: list[dict]) -> str:
    """Format the rows of `compare`."""
    lines = [f"{'step':40} {'ratio':>6} {'step s':>9} {'windows/s':>10}"]
    lines += [
        f"{row['step']:40} {row['ratio']:6.2f} {row['step_seconds']:9.4f} {row['windows_per_second']:10.1f}"
        for row in rows
    ]
    return "\n".join(
        [*lines, "", f"batch of {rows[0]['batch_size']}, {rows[0]['device']}, {rows[0]['threads']} threads"]
    )


def as_table(rows: list[dict]) -> str:
    header = (*_SETTINGS, "compile s", "step s", "windows/s", "TFLOP/s", "speed", "memory a device")
    cells = [
        (
            *(str(row[name]) for name in _SETTINGS),
            f"{row['compile_seconds']:.1f}",
            f"{row['step_seconds']:.4f}",
            f"{row['windows_per_second']:.1f}",
            f"{row['tflops']:.3g}",
            f"{row['speed']:.2f}",
            gib(row["memory"]["total"]) if row["memory"] else "",
        )
        for row in rows
    ]
    widths = [max(map(len, column)) for column in zip(header, *cells, strict=True)]
    return "\n".join("  ".join(cell.rjust(width) for cell, width in zip(line, widths)) for line in (header, *cells))


if __name__ == "__main__":
    keep_memory()
    sys.exit(main())
