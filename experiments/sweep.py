"""Train a config over a grid of settings: one run after another, or each run as a task of a Slurm array.

    python experiments/sweep.py --config FILE[:SIZE] --workdir DIR --grid seed=0,1,2 --grid train.batch_size=64,128

Any --config.KEY=VALUE is passed to every run. Each run has the workdir DIR/NAME and the log DIR/NAME.log. The same
command continues an interrupted sweep and skips finished runs. At the end it prints a table of the validation scores of
the best checkpoints, with means over seeds, and writes DIR/sweep.json.

As a Slurm array: `N=$(python experiments/sweep.py ... --list | wc -l)`, then `sbatch --array=0-$((N-1))` of a script
with the same command; each task trains one run, and the command without Slurm then gives the table.
"""

import argparse
import json
import math
import os
import pathlib
import statistics
import sys
from collections.abc import Sequence
from typing import Any

from tables.plan import plan_grid
from tables.runs import Stop, Stopped, run_all, run_logged, stop_signals
from tables.workdirs import Run, is_finished

from ha2g_jax.errors import UserError
from ha2g_jax.files.writing import write_text, writing
from ha2g_jax.train.workdir import METRICS, VALIDATION_PREFIX, read_metrics

TRAIN = (sys.executable, "-m", "ha2g_jax.cli", "train")
SEED = "seed"
Scores = dict[str, float]


def main(argv: Sequence[str] | None = None, train: Sequence[str] = TRAIN) -> int:
    """Run a sweep and return its exit code, as `run_script` does; `train` is a command that trains one run."""
    try:
        arguments, overrides = _parser().parse_known_args(argv)
        runs = plan_grid(arguments.config, arguments.workdir, arguments.grid, overrides)
        if arguments.list:
            print("\n".join(f"{index}\t{run.name}" for index, run in enumerate(runs)))
            return 0
        with writing(arguments.workdir, "choose another --workdir"):
            arguments.workdir.mkdir(parents=True, exist_ok=True)
        commands = {run.name: [*train, *_arguments(run, arguments.config, overrides)] for run in runs}
        if task := os.environ.get("SLURM_ARRAY_TASK_ID"):
            # Replaces this process, so that a signal of Slurm reaches the run once.
            os.execv(train[0], commands[_chosen(runs, task).name])
        return _train_all(runs, commands, arguments.workdir)
    except UserError as error:
        print(f"sweep: {error}", file=sys.stderr)
        return 2


def gather(runs: Sequence[Run]) -> dict[str, Any]:
    """Collect the state and the validation scores of every run, and their means and deviations over finished seeds.

    Returns:
        {"runs", "groups"} as JSON values.
    """
    rows: list[dict[str, Any]] = [
        {"name": run.name, "settings": dict(run.changed), "finished": is_finished(run)} | _progress(run) for run in runs
    ]
    groups: dict[str, dict[str, Any]] = {}
    for row in rows:
        settings = {key: value for key, value in row["settings"].items() if key != SEED}
        group = groups.setdefault(json.dumps(settings), {"settings": settings, "scores": []})
        if row["finished"] and row["validation"]:
            group["scores"].append(row["validation"])
    return {"runs": rows, "groups": [_summary(**group) for group in groups.values()]}


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


def _arguments(run: Run, spec: str, overrides: Sequence[str]) -> list[str]:
    changes = [f"--config.{key}={value}" for key, value in run.changed.items()]
    return ["--config", spec, "--workdir", str(run.workdir), *overrides, *changes]


def _train_all(runs: Sequence[Run], commands: dict[str, list[str]], workdir: pathlib.Path) -> int:
    def perform(run: Run, _: int, stop: Stop) -> None:
        log = run.workdir.with_name(f"{run.name}.log")
        error = run_logged(commands[run.name], log, stop)
        if error is None and not is_finished(run):
            error = f"it ended before step {run.config.train.steps}; see {log}"
        if error and stop.number is None:
            raise UserError(error)

    code = 0
    with stop_signals() as stop:
        try:
            code = 1 if run_all([run for run in runs if not is_finished(run)], perform, stop, "sweep") else 0
        except Stopped as stopped:
            code = 128 + stopped.number
    gathered = gather(runs)
    write_text(workdir / "sweep.json", json.dumps(gathered, indent=1) + "\n")
    print(as_table(gathered))
    return code


def _progress(run: Run) -> dict[str, Any]:
    """Return the last step of a run and the validation scores of its best checkpoint."""
    path, best_by = run.workdir / METRICS, run.config.train.best_by
    lines = read_metrics(path) if path.is_file() else []
    scores = [
        {k.removeprefix(VALIDATION_PREFIX): v for k, v in line.items() if k.startswith(VALIDATION_PREFIX)}
        for line in lines
    ]
    best = min(
        (line for line in scores if math.isfinite(line.get(best_by, math.nan))),
        key=lambda line: line[best_by],
        default={},
    )
    return {"step": lines[-1]["step"] if lines else 0, "validation": best}


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
