"""Process of one run of the study, which `jobs` starts with the task as JSON on its standard input."""

import pathlib
import sys
from typing import Any

from tables.latency_plan import plan_settings
from tables.worker import finish_training, main, read_request


def perform(task: dict[str, Any]) -> None:
    """Train the run of a task and score it at all look-aheads, as far as either is missing.

    Args:
        task: {"request", "corpus", "run", "cores", "options": {"split"}}, as `jobs` writes it.

    Raises:
        UserError: the training or the scoring failed.
    """
    from tables.latency_scores import score_run

    request, corpus = read_request(task), pathlib.Path(task["corpus"])
    runs = [run for each in plan_settings(request, corpus).values() for run in each]
    run = next(run for run in runs if run.name == task["run"])
    if finish_training(run, request):
        score_run(run, corpus, task["options"]["split"])


if __name__ == "__main__":
    sys.exit(main(perform))
