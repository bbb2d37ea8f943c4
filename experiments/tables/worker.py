"""Process of one run of a table, which `jobs` starts with the task as JSON on its standard input."""

import json
import os
import pathlib
import sys
from collections.abc import Callable, Mapping
from typing import Any

from ha2g_jax.errors import UserError
from ha2g_jax.train.process import prepare_process
from tables.plan import Run, is_finished, make_plan
from tables.request import Request


def main(work: Callable[[dict[str, Any]], None]) -> int:
    """Carry out the task on the standard input and return the exit code.

    Args:
        work: function that trains and scores the run of a task.
    """
    prepare_process()
    task = json.load(sys.stdin)
    if task["cores"]:
        os.sched_setaffinity(0, task["cores"])  # before JAX counts the cores
    try:
        work(task)
    except UserError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    return 0


def read_request(task: Mapping[str, Any]) -> Request:
    """Return the request of a task."""
    values = task["request"]
    return Request(**(values | {"workdir": pathlib.Path(values["workdir"]), "seeds": tuple(values["seeds"])}))


def finish_training(run: Run, request: Request) -> bool:
    """Train a run if it is not finished and the request has training; return whether the run can be scored.

    Raises:
        UserError: the training failed.
    """
    if not request.has_training or is_finished(run):
        return True
    from ha2g_jax.train.loop import train

    train(run.config, run.workdir)
    return is_finished(run)  # not if the training was stopped


def perform(task: dict[str, Any]) -> None:
    """Train and score the run of a task, as far as either is missing.

    Args:
        task: {"request", "corpus", "run", "cores", "options"}, as `jobs` writes it.

    Raises:
        UserError: the training or the scoring failed.
    """
    from tables.run_scores import score_run

    request = read_request(task)
    plan = make_plan(request, pathlib.Path(task["corpus"]))
    run = next(run for run in (plan.autoencoder, *plan.runs) if run.name == task["run"])
    if finish_training(run, request) and run is not plan.autoencoder:
        score_run(run, plan, request)


if __name__ == "__main__":
    sys.exit(main(perform))
