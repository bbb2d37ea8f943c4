"""Process of one run of a table, which `jobs` starts with the task as JSON on its standard input."""

import json
import os
import pathlib
import sys
from typing import Any

from ha2g_jax.errors import UserError


def main() -> int:
    """Train and score the run on the standard input and return the exit code."""
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
    """Train and score the run of a task, as far as either is missing.

    Args:
        task: {"request", "corpus", "run", "cores"}, as `jobs` writes it.

    Raises:
        UserError: the training or the scoring failed.
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
            return  # the training was stopped
    if run is not plan.autoencoder:
        score_run(run, plan, request)


if __name__ == "__main__":
    sys.exit(main())
