"""The process of one run of a table: `jobs` starts it and writes what to do to its standard input."""

import json
import os
import pathlib
import sys
from typing import Any

from ha2g_jax.errors import UserError


def main() -> int:
    """Train a run and scores it, whatever of the two is missing; returns the exit code."""
    task = json.load(sys.stdin)
    if task["cores"]:
        os.sched_setaffinity(0, task["cores"])  # before JAX counts the cores
    try:
        perform(task)
    except UserError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    return 0


def perform(task: dict[str, Any]) -> None:
    """Train and scores the run of a task.

    Args:
        task: {"request", "corpus", "run", "cores"}, as `jobs` writes it.

    Raises:
        UserError: what went wrong, in one line.
    """
    from ha2g_jax.study.reproduction.plan import Request, is_finished, make_plan
    from ha2g_jax.study.reproduction.run_scores import score_run

    values = task["request"]
    request = Request(**(values | {"workdir": pathlib.Path(values["workdir"]), "seeds": tuple(values["seeds"])}))
    plan = make_plan(request, pathlib.Path(task["corpus"]))
    run = next(run for run in (plan.autoencoder, *plan.runs) if run.name == task["run"])
    if request.has_training and not is_finished(run):
        from ha2g_jax.train.loop import train

        train(run.config, run.workdir)
        if not is_finished(run):
            return  # it was asked to stop
    if run is not plan.autoencoder:
        score_run(run, plan, request)


if __name__ == "__main__":
    sys.exit(main())
