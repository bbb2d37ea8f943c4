"""Train a config over a grid of settings: one run after another, or each run as a task of a Slurm array.

    python experiments/sweep.py --config FILE[:SIZE] --workdir DIR --grid seed=0,1,2 --grid train.batch_size=64,128

Any --config.KEY=VALUE is passed to every run. Each run has the workdir DIR/NAME and the log DIR/NAME.log. The same
command continues an interrupted sweep and skips finished runs. At the end it prints a table with means over seeds and
writes DIR/sweep.json.

As a Slurm array: `N=$(python experiments/sweep.py ... --list | wc -l)`, then `sbatch --array=0-$((N-1))` of a script
with the same command; each task trains one run, and the command without Slurm then gives the table.
"""

import argparse
import itertools
import json
import os
import pathlib
import re
import statistics
import sys
from collections.abc import Sequence
from typing import Any, NamedTuple

from ha2g_jax.config.settings import Config
from ha2g_jax.errors import UserError
from ha2g_jax.files.child_process import run_logged, stop_signals
from ha2g_jax.files.writing import whole_file
from ha2g_jax.launch import load_config
from ha2g_jax.train.workdir import METRICS, read_metrics

TRAIN = (sys.executable, "-m", "ha2g_jax.cli", "train")
SEED = "seed"
Scores = dict[str, float]


class Run(NamedTuple):
    """One point of the grid.

    Attributes:
        name: name of the run and of its folder.
        settings: dotted name of a setting -> value as text.
        arguments: command-line arguments of the training.
        config: config of the training.
        workdir: folder of the training.
    """

    name: str
    settings: dict[str, str]
    arguments: list[str]
    config: Config
    workdir: pathlib.Path


def main(argv: Sequence[str] | None = None, train: Sequence[str] = TRAIN) -> int:
    """Run a sweep.

    Args:
        argv: command-line arguments; by default those of this process.
        train: command that trains one run, without its arguments.

    Returns:
        Exit code: 0, 1 if a run failed, 2 for a mistake of the user, 128 + the number of the signal that stopped it.
    """
    try:
        arguments, overrides = _parser().parse_known_args(argv)
        runs = plan(arguments.config, arguments.workdir, arguments.grid, overrides)
        if arguments.list:
            print("\n".join(f"{index}\t{run.name}" for index, run in enumerate(runs)))
            return 0
        try:
            arguments.workdir.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UserError(
                f"cannot make the folder {arguments.workdir} ({error.strerror}); choose another --workdir"
            ) from error
        if task := os.environ.get("SLURM_ARRAY_TASK_ID"):
            # Replaces this process, so that a signal of Slurm reaches the run once.
            os.execv(train[0], [*train, *_chosen(runs, task).arguments])
        return _train_all(runs, train, arguments.workdir)
    except UserError as error:
        print(f"sweep: {error}", file=sys.stderr)
        return 2


def plan(spec: str, workdir: pathlib.Path, grids: Sequence[str], overrides: Sequence[str] = ()) -> list[Run]:
    """Plan the runs of the product of several grids.

    Args:
        spec: FILE[:SIZE] of the config.
        workdir: folder of the workdirs of all runs.
        grids: texts of the form KEY=VALUE,VALUE...; the last one changes fastest.
        overrides: further arguments of every run, --config.KEY=VALUE.

    Returns:
        All runs.

    Raises:
        UserError: a grid or a setting of any run is not valid.
    """
    values = {}
    for grid in grids:
        key, _, text = grid.partition("=")
        if not key or not text or key in values:
            raise UserError(
                f"--grid {grid} is not KEY=VALUE,VALUE..., or another grid has its key; give each a key of its own, "
                "such as --grid seed=0,1,2"
            )
        values[key] = _split(text)
    short = {key: key.rpartition(".")[2] for key in values}
    labels = {key: name if list(short.values()).count(name) == 1 else key for key, name in short.items()}
    runs = []
    for point in itertools.product(*values.values()):
        settings = dict(zip(values, point, strict=True))
        name = ",".join(f"{labels[key]}={value}" for key, value in settings.items())
        name = re.sub(r"[^\w.,=+-]+", "_", re.sub(r"[][(){}\s]", "", name))
        changes = [*overrides, *(f"--config.{key}={value}" for key, value in settings.items())]
        arguments = ["--config", spec, "--workdir", str(workdir / name), *changes]
        runs.append(Run(name, settings, arguments, load_config(spec, changes), workdir / name))
    if len({run.name for run in runs}) < len(runs):
        raise UserError(f"two runs of the grid {' '.join(grids)} are the same; give every value once")
    return runs


def gather(runs: Sequence[Run]) -> dict[str, Any]:
    """Collect the state and the validation scores of every run, and their means and deviations over finished seeds.

    Args:
        runs: runs of the sweep.

    Returns:
        {"runs", "groups"} as JSON values.
    """
    rows = [
        {"name": run.name, "settings": run.settings, "finished": is_finished(run)} | _progress(run.workdir)
        for run in runs
    ]
    groups: dict[str, dict[str, Any]] = {}
    for row in rows:
        settings = {key: value for key, value in row["settings"].items() if key != SEED}
        group = groups.setdefault(json.dumps(settings), {"settings": settings, "scores": []})
        if row["finished"] and row["validation"]:
            group["scores"].append(row["validation"])
    return {"runs": rows, "groups": [_summary(**group) for group in groups.values()]}


def is_finished(run: Run) -> bool:
    """Return whether the workdir has the checkpoint of the last step of exactly this config."""
    if not (run.workdir / "latest" / str(run.config.train.steps)).is_dir():
        return False
    try:
        return json.loads((run.workdir / "config.json").read_text()) == json.loads(run.config.to_json())
    except (OSError, ValueError):
        return False  # the training itself reports what is wrong


def as_table(gathered: dict[str, Any]) -> str:
    """Format the result of `gather`: a line for each run, then for each group of seeds mean ± standard deviation."""
    terms = sorted({name for row in gathered["runs"] for name in row["validation"]})
    lines = [["run", "step", *terms]]
    for row in gathered["runs"]:
        scores = [f"{row['validation'][term]:.5g}" if term in row["validation"] else "-" for term in terms]
        lines.append([row["name"], f"{row['step']}{'' if row['finished'] else ' (unfinished)'}", *scores])
    for group in gathered["groups"]:
        if group["runs"] > 1:
            name = ",".join(f"{key}={value}" for key, value in group["settings"].items()) or "all"
            mean, deviation = group["mean"], group["standard_deviation"]
            scores = [f"{mean[term]:.5g} ± {deviation[term]:.2g}" if term in mean else "-" for term in terms]
            lines.append([name, f"{group['runs']} seeds", *scores])
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return "\n".join("  ".join(map(str.ljust, line, widths)).rstrip() for line in lines)


def _train_all(runs: Sequence[Run], train: Sequence[str], workdir: pathlib.Path) -> int:
    is_good = True
    with stop_signals() as stop:
        for index, run in enumerate(runs):
            if stop.number is not None:
                break
            print(f"[{index + 1}/{len(runs)}] {run.name}: ", end="", flush=True)
            log = run.workdir.with_name(f"{run.name}.log")
            error = None if is_finished(run) else run_logged([*train, *run.arguments], log, stop)
            if error is None and stop.number is None and not is_finished(run):
                error = f"it ended before step {run.config.train.steps}; see {log}"
            is_good &= error is None
            print(f"failed: {error}" if error else "finished" if stop.number is None else "stopped", flush=True)
    gathered = gather(runs)
    with whole_file(workdir / "sweep.json") as temporary:
        temporary.write_text(json.dumps(gathered, indent=1) + "\n")
    print(as_table(gathered))
    if stop.number is not None:
        return 128 + stop.number
    return 0 if is_good else 1


def _progress(workdir: pathlib.Path) -> dict[str, Any]:
    """Return the last step of a run and its last validation scores."""
    path = workdir / METRICS
    lines = read_metrics(path) if path.is_file() else []
    prefix = "validation/"
    scores = [{k.removeprefix(prefix): v for k, v in line.items() if k.startswith(prefix)} for line in lines]
    last = next((line for line in reversed(scores) if line), {})
    return {"step": lines[-1]["step"] if lines else 0, "validation": last}


def _summary(settings: dict[str, str], scores: list[Scores]) -> dict[str, Any]:
    terms = sorted(set.intersection(*(set(score) for score in scores))) if scores else []
    columns = {term: [score[term] for score in scores] for term in terms}
    return {
        "settings": settings,
        "runs": len(scores),
        "mean": {term: statistics.fmean(column) for term, column in columns.items()},
        "standard_deviation": {
            term: statistics.stdev(column) if len(column) > 1 else 0.0 for term, column in columns.items()
        },
    }


def _split(text: str) -> list[str]:
    """Split text at commas outside of brackets: "(0.5,0.9),(0.9,0.99)" has two values."""
    values, depth = [""], 0
    for character in text:
        depth += (character in "([{") - (character in ")]}")
        if character == "," and not depth:
            values.append("")
        else:
            values[-1] += character
    if depth or not all(values):
        raise UserError(f"{text!r} is not a list of values between commas; close the brackets and leave none empty")
    return values


def _chosen(runs: Sequence[Run], task: str) -> Run:
    """Return the run of a task of a Slurm array."""
    if not task.isdecimal() or int(task) >= len(runs):
        raise UserError(f"SLURM_ARRAY_TASK_ID is {task}, the grid has {len(runs)} runs: use --array=0-{len(runs) - 1}")
    return runs[int(task)]


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False
    )
    parser.add_argument("--config", required=True, help="FILE[:SIZE], as for ha2g train")
    parser.add_argument("--workdir", required=True, type=pathlib.Path, help="folder of the workdirs of all runs")
    parser.add_argument("--grid", required=True, action="append", help="KEY=VALUE,VALUE...; may be given again")
    parser.add_argument("--list", action="store_true", help="print the number and name of every run, and exit")
    return parser


if __name__ == "__main__":
    sys.exit(main())
