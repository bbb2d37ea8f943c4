"""Execution of the runs of a table in separate processes, several at once, and the display of their progress."""

import concurrent.futures
import contextlib
import json
import os
import pathlib
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias

import tqdm

from ha2g_jax.errors import UserError
from ha2g_jax.files.child_process import Stop, run_logged
from tables.plan import Run
from tables.request import Request

_WORKER = (sys.executable, "-m", "tables.worker")  # of the tables of the paper
_LOOK_EVERY = 1.0  # seconds between updates of the progress
_TAIL = 4096  # bytes at the end of metrics.jsonl that contain its last line


class Stopped(Exception):
    """A signal ended the work.

    Attributes:
        number: number of the signal.
    """

    def __init__(self, number: int):
        super().__init__(f"stopped by signal {number}")
        self.number = number


# Function that trains a run if it is not finished, and scores it: (request, corpus, run, number of the worker, stop).
# It raises a UserError with the reason where it fails.
Perform: TypeAlias = Callable[[Request, pathlib.Path, Run, int, Stop], None]


def run_all(
    request: Request, corpus: pathlib.Path, runs: Sequence[Run], perform: Perform, stop: Stop, title: str
) -> dict[str, str]:
    """Execute runs, `request.jobs` at once; a run that fails does not end the others.

    Args:
        request: request that the runs belong to.
        corpus: folder of the corpus.
        runs: runs in the order in which they start.
        perform: function that trains and scores one run, such as `perform_in_process`.
        stop: signal that ends the runs.
        title: title of the progress bar.

    Returns:
        Name of a run that failed -> reason in one line.

    Raises:
        Stopped: a signal came; the progress of the runs is saved.
    """
    failures: dict[str, str] = {}
    watch = _Watch(runs, title)
    idle = list(range(request.jobs))
    queue = list(runs)
    working: dict[concurrent.futures.Future, tuple[Run, int, float]] = {}
    with contextlib.closing(watch), concurrent.futures.ThreadPoolExecutor(request.jobs) as threads:
        while queue or working:
            while queue and idle and stop.number is None:
                run, worker = queue.pop(0), idle.pop(0)
                future = threads.submit(perform, request, corpus, run, worker, stop)
                working[future] = run, worker, time.monotonic()
            if not working:
                break
            done, _ = concurrent.futures.wait(working, _LOOK_EVERY, concurrent.futures.FIRST_COMPLETED)
            for future in done:
                run, worker, start = working.pop(future)
                idle.append(worker)
                try:
                    future.result()
                except (UserError, OSError) as error:
                    failures[run.name] = " ".join(str(error).split())
                if stop.number is None:
                    watch.finish(run, time.monotonic() - start, failures.get(run.name))
            watch.look([run for run, _, _ in working.values()])
    if stop.number is not None:
        raise Stopped(stop.number)
    return failures


def perform_in_process(
    request: Request,
    corpus: pathlib.Path,
    run: Run,
    worker: int,
    stop: Stop,
    *,
    command: Sequence[str] | None = None,
    options: Mapping[str, Any] | None = None,
) -> None:
    """Train and score one run in a process of its own, whose output goes to RUN.log beside the workdir.

    Args:
        request: request that the run belongs to.
        corpus: folder of the corpus.
        run: run to train and score.
        worker: number of the worker, from 0.
        stop: signal that ends the process.
        command: command of the process; by default that of the tables of the paper, see `worker`.
        options: values of JSON that the task has beside the request.

    Raises:
        UserError: the process failed; the message is its last line of output.
    """
    path = run.workdir.with_name(f"{run.name}.log")
    cores = _cores(worker, request.jobs)
    task = {
        "request": request._asdict() | {"workdir": str(request.workdir.resolve())},
        "corpus": str(corpus),
        "run": run.name,
        "cores": cores,
        "options": dict(options or {}),
    }
    given = json.dumps(task).encode()
    environment = _environment(request, len(cores), os.environ)
    error = run_logged([*(command or _WORKER), run.name], path, stop, given=given, environment=environment)
    if error and stop.number is None:
        raise UserError(error)


def _cores(worker: int, jobs: int) -> list[int]:
    """Return the cores of this process that a worker may use; [] for all of them."""
    if jobs == 1 or not hasattr(os, "sched_getaffinity"):
        return []
    cores = sorted(os.sched_getaffinity(0))
    size = max(len(cores) // jobs, 1)
    start = worker * size % len(cores)
    return cores[start : start + size]


def _environment(request: Request, num_cores: int, environment: Mapping[str, str]) -> dict[str, str]:
    """Return the environment of a worker on `num_cores` cores, 0 for all; variables that the user has set are kept."""
    defaults = {
        # The seeds of a row have the same program, which is compiled once.
        "JAX_COMPILATION_CACHE_DIR": str(request.workdir.resolve() / "compiled"),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.5",
    }
    if num_cores:
        # NumPy counts the cores before the worker limits itself to its own. Its threads, which wait for each other in
        # a loop, would take turns on these.
        defaults["OPENBLAS_NUM_THREADS"] = str(num_cores)
    if request.jobs > 1:  # the first process on an accelerator would take most of its memory
        defaults["XLA_PYTHON_CLIENT_MEM_FRACTION"] = f"{0.9 / request.jobs:.2f}"
    return defaults | dict(environment)


class _Watch:
    """A progress bar of the steps of all runs, and a line for each run that ends."""

    def __init__(self, runs: Sequence[Run], title: str):
        self._steps = {run.name: int(run.config.train.steps) for run in runs}
        self._done = {run.name: last_step(run) for run in runs}
        self._before = sum(self._done.values())
        self._start = time.monotonic()
        self._count = 0
        total = sum(self._steps.values())
        self._bar = tqdm.tqdm(total=total, initial=self._before, desc=title, unit="step", disable=None, leave=False)

    def look(self, working: Sequence[Run]) -> None:
        for run in working:
            step = min(last_step(run), self._steps[run.name])
            self._before -= max(self._done[run.name] - step, 0)  # a resumed run repeats steps after its checkpoint
            self._done[run.name] = step
        self._bar.set_postfix_str(", ".join(run.name for run in working), refresh=False)
        self._bar.update(sum(self._done.values()) - self._bar.n)

    def finish(self, run: Run, seconds: float, failure: str | None) -> None:
        self._count += 1
        self._done[run.name] = self._steps[run.name]
        state = f"failed: {failure}" if failure else f"finished in {duration(seconds)}"
        line = f"[{self._count}/{len(self._steps)}] {run.name}: {state}"
        if self._count < len(self._steps):
            line += f"; about {duration(self._left())} left"
        tqdm.tqdm.write(line, file=sys.stderr)

    def close(self) -> None:
        self._bar.close()

    def _left(self) -> float:
        """Estimate the remaining seconds from the steps of all runs, or from the runs while only scores were made."""
        passed, done = time.monotonic() - self._start, sum(self._done.values())
        if (new := done - self._before) and (remaining := sum(self._steps.values()) - done):
            return passed * remaining / new
        return passed * (len(self._steps) - self._count) / self._count


def last_step(run: Run) -> int:
    """Return the last step for which a run has written metrics, or 0."""
    try:
        with (run.workdir / "metrics.jsonl").open("rb") as file:
            file.seek(max(0, file.seek(0, os.SEEK_END) - _TAIL))
            lines = file.read().splitlines(keepends=True)
        return next(int(json.loads(line)["step"]) for line in reversed(lines) if line.endswith(b"\n"))
    except (OSError, ValueError, KeyError, StopIteration):
        return 0


def duration(seconds: float) -> str:
    """Format seconds, such as "41 s", "12 min" or "3 h 20 min"."""
    if seconds < 60:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"
