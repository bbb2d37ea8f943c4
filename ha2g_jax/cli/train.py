"""The commands `ha2g train`, `runs` and `doctor`: arguments only; each calls one function of the package."""

import argparse
import json
import pathlib
from typing import Any

from ha2g_jax.cli.parser import CONFIG, MODEL, positive, refuse_others

_SORTS = ("name", "step", "best", "state", "changed")
_BENCHMARK = ("batch_size", "precision", "steps", "table1")


def add_commands(commands: Any) -> None:
    """Add `train`, `runs` and `doctor` to the commands of a parser."""
    # absl reads the flags of `train`, see `launch.main`.
    commands.add_parser("train", help="train a model, or continue a run", add_help=False)

    runs = commands.add_parser("runs", help="list training runs, or draw their curves")
    runs.description = (
        "List training runs with their progress, best score, state, and the settings in which they differ; or draw "
        "their curves, with one line and a band for runs that differ only in the seed."
    )
    runs.add_argument(
        "runs", type=pathlib.Path, nargs="+", metavar="RUN", help="workdir of ha2g train, or a folder of workdirs"
    )
    runs.add_argument("-o", "--out", type=pathlib.Path, metavar="FILE", help="curves to write, .html, .png or .svg")
    runs.add_argument(
        "--smooth",
        type=float,
        metavar="FRACTION",
        help="width of the running mean of a curve as a fraction of the steps; 0 for none (default: 0.04)",
    )
    runs.add_argument(
        "--sort",
        choices=_SORTS,
        help="order of the list: by name, most steps, least score, state, or last changed first (default: name)",
    )
    runs.add_argument("--json", action="store_true", help="print the list as JSON")
    runs.set_defaults(run=_runs)

    doctor = commands.add_parser("doctor", help="check the machine, or describe and measure a model on it")
    doctor.description = (
        "Check devices, versions, memory and data, and time one step of training; or describe the modules of a model, "
        "measure its speed, or measure the gradients of the terms of its objective."
    )
    doctor.add_argument(
        "--config",
        metavar="CONFIG",
        help=f"{CONFIG} (default: talk:small; for a check of the machine, the smallest model); --config.NAME=VALUE "
        "changes a setting, as in ha2g train",
    )
    kind = doctor.add_mutually_exclusive_group()
    kind.add_argument("--describe", action="store_true", help="print shapes and parameter counts of every module")
    kind.add_argument("--benchmark", action="store_true", help="measure the speed of training and generation")
    kind.add_argument("--gradients", action="store_true", help="measure the gradient of each term of the objective")
    doctor.add_argument(
        "--checkpoint",
        nargs="+",
        metavar="MODEL",
        help=f"{MODEL}: with --gradients, models to measure as well; with --benchmark, the one that generates "
        "(default: demo)",
    )
    speed = doctor.add_argument_group("speed, with --benchmark")
    speed.add_argument("--batch-size", type=positive, metavar="B", help="windows in a step (default: the config's)")
    speed.add_argument(
        "--precision",
        nargs="+",
        choices=("float32", "tensorfloat32", "bfloat16"),
        help="precisions to compare (default: float32 on a CPU, else all)",
    )
    speed.add_argument("--steps", type=positive, metavar="N", help="timed steps (default: 10)")
    speed.add_argument(
        "--table1",
        nargs="*",
        metavar="DATA[:SIZE]",
        help="print the hours of all runs of Table 1 of the paper with three seeds, by steps that are measured here, "
        "which takes minutes for each method (default: ted_expressive ted_gesture)",
    )
    doctor.add_argument("--json", action="store_true", help="print JSON instead of text")
    doctor.set_defaults(run=_doctor, overrides=())


def _runs(arguments: argparse.Namespace) -> None:
    if arguments.out is None:
        from ha2g_jax.train.runs import as_json, as_table, list_runs

        refuse_others(arguments, (), ("smooth",), "a list; name a page with --out, to which it belongs")
        runs = list_runs(arguments.runs, arguments.sort or "name")
        print(json.dumps(as_json(runs), indent=1) if arguments.json else as_table(runs))
        return
    from ha2g_jax.train.plot import write_plot

    refuse_others(arguments, (), ("sort", "json"), "a page of curves")
    smoothing = 0.04 if arguments.smooth is None else arguments.smooth
    print(write_plot(arguments.runs, arguments.out, smoothing=smoothing))


def _doctor(arguments: argparse.Namespace) -> int:
    from ha2g_jax import launch

    options = {"describe": (), "gradients": ("checkpoint",), "benchmark": ("checkpoint", *_BENCHMARK)}
    kind = next((name for name in options if getattr(arguments, name)), "")
    title = f"--{kind}" if kind else "a check of the machine"
    refuse_others(arguments, options.get(kind, ()), options["benchmark"], title)
    spec = arguments.config or ((kind or arguments.overrides) and "talk:small")
    config = launch.load_config(spec, arguments.overrides) if spec else None

    if arguments.describe:
        from ha2g_jax.train import describe

        return _print(describe.describe(config), describe.as_table, arguments.json)
    if arguments.gradients:
        from ha2g_jax.train import gradients

        return _print(gradients.measure(config, arguments.checkpoint or ()), gradients.as_table, arguments.json)
    if arguments.benchmark:
        return _benchmark(arguments, config)
    from ha2g_jax.train import doctor

    findings = doctor.examine(config)
    print(json.dumps(doctor.as_json(findings), indent=1) if arguments.json else doctor.as_text(findings))
    return 0 if doctor.is_well(findings) else 1


def _benchmark(arguments: argparse.Namespace, config: Any) -> int:
    from ha2g_jax.errors import UserError
    from ha2g_jax.evaluation import benchmark

    if arguments.table1 is not None:
        from ha2g_jax.evaluation import hours

        refuse_others(arguments, ("table1", "steps"), ("config", "checkpoint", *_BENCHMARK), "--table1")
        rows = hours.table1(arguments.table1 or ["ted_expressive", "ted_gesture"], arguments.steps or 5, seeds=3)
        return _print(rows, hours.as_table, arguments.json)
    checkpoints = arguments.checkpoint or ["demo"]
    if len(checkpoints) > 1:
        raise UserError(f"--benchmark measures one model that generates, not {len(checkpoints)}; give one --checkpoint")
    if arguments.batch_size:
        config.train.batch_size = arguments.batch_size
    result = benchmark.measure(config, checkpoints[0], arguments.precision, arguments.steps or 10)
    return _print(result, benchmark.as_tables, arguments.json)


def _print(result: Any, as_text: Any, is_json: bool) -> int:
    print(json.dumps(result, indent=1) if is_json else as_text(result))
    return 0
