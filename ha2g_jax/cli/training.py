"""The commands `ha2g runs`, `ha2g plot` and `ha2g average`, for what training has written: arguments only."""

import argparse
import json
import pathlib
from typing import Any

_SORTS = ("name", "step", "best", "state", "changed")


def add_commands(commands: Any) -> None:
    """Add `runs`, `plot` and `average` to the commands of a parser.

    Args:
        commands: subparsers of the parser of `ha2g`.
    """
    runs = commands.add_parser("runs", help="list training runs with settings, progress, best score and state")
    runs.description = "List the training runs below a folder, and the settings in which they differ."
    runs.add_argument("folder", type=pathlib.Path, help="folder with workdirs of ha2g train at any depth")
    runs.add_argument(
        "--sort",
        choices=_SORTS,
        default="name",
        help="order: by name, most steps, least score, state, or last changed first (default: name)",
    )
    runs.add_argument("--json", action="store_true", help="print JSON instead of a table")
    runs.set_defaults(run=_runs)

    plot = commands.add_parser("plot", help="write a page with the curves of training runs, which works offline")
    plot.description = (
        "Write one HTML page with the curves of all metrics of training runs, over one another, with their states, "
        "the settings in which they differ, and pictures of their motion. Runs that differ only in the seed are one "
        "line with a band. See docs/training.md."
    )
    plot.add_argument(
        "runs", type=pathlib.Path, nargs="+", metavar="RUN", help="workdir of ha2g train, or a folder of workdirs"
    )
    plot.add_argument(
        "-o",
        "--out",
        type=pathlib.Path,
        default=pathlib.Path("training.html"),
        help=".html file to write (default: training.html)",
    )
    plot.add_argument(
        "--smooth",
        type=float,
        default=0.04,
        metavar="FRACTION",
        help="width of the running mean as a fraction of the steps; 0 for none (default: 0.04)",
    )
    plot.add_argument(
        "--samples",
        type=int,
        default=2,
        metavar="N",
        help="validation clips to draw the motion for, which loads models and takes a while; 0 for none (default: 2)",
    )
    plot.set_defaults(run=_plot)

    average = commands.add_parser("average", help="write the average of the weights of several models as one model")
    average.description = (
        "Write a model whose weights are the mean of those of models that were trained from the same weights. "
        "See docs/training.md."
    )
    average.add_argument(
        "models", nargs="+", metavar="MODEL", help="workdir of ha2g train, checkpoint in it, or model folder"
    )
    average.add_argument(
        "-o", "--out", type=pathlib.Path, required=True, metavar="FOLDER", help="folder of the model to write"
    )
    average.set_defaults(run=_average)


def _runs(arguments: argparse.Namespace) -> None:
    from ha2g_jax.train.report import listing

    runs = listing.list_runs(arguments.folder, arguments.sort)
    print(json.dumps(listing.as_json(runs), indent=1) if arguments.json else listing.as_table(runs))


def _plot(arguments: argparse.Namespace) -> None:
    from ha2g_jax.train.report.report import write_report

    print(write_report(arguments.runs, arguments.out, smoothing=arguments.smooth, num_clips=arguments.samples))


def _average(arguments: argparse.Namespace) -> None:
    from ha2g_jax.checkpoint.averaging import average_models

    print(average_models(arguments.models, arguments.out))
