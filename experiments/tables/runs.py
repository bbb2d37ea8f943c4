"""Train and score runs in separate processes, several at once, and show their progress.

As a program, `python -m tables.runs NAME`, it is the process of one run, with its task as JSON on the standard input.
"""

import argparse
import concurrent.futures
import contextlib
import json
import os
import pathlib
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, TypeAlias

import tqdm

from ha2g_jax.cli.parser import positive
from ha2g_jax.config.presets import SIZES
from ha2g_jax.errors import UserError
from ha2g_jax.progress import progress_bar
from ha2g_jax.stopping import on_stop_signals
from tables import look_aheads
from tables.plan import WORKDIR, Request, TablePlan, plan_table
from tables.workdirs import Run, is_finished, last_step

_WORKER = (sys.executable, "-m", "tables.runs")
DEFAULT_SEEDS = "3"
_LOOK_EVERY = 1.0  # seconds between updates of the progress


class Stop:
    """State of a request to stop, which is passed on to child processes.

    Attributes:
        number: number of the signal that requested the stop, None before.
    """

    def __init__(self) -> None:
        self.number: int | None = None
        self._processes: set[subprocess.Popen] = set()

    def handle(self, number: int) -> None:
        """Ask the child processes to save and end; kill them if called again."""
        is_first = self.number is None
        self.number = number
        for process in list(self._processes):
            self._end(process, signal.SIGTERM if is_first else signal.SIGKILL)

    def wait(self, process: subprocess.Popen) -> int:
        """Wait for a child process, which is ended when a stop is requested, and return its exit code."""
        self._processes.add(process)
        try:
            if self.number is not None:  # the signal came while the process was being started
                self._end(process, signal.SIGTERM)
            return process.wait()
        finally:
            self._processes.discard(process)

    def _end(self, process: subprocess.Popen, number: int) -> None:
        if process.poll() is None:
            process.send_signal(number)


@contextlib.contextmanager
def stop_signals() -> Iterator[Stop]:
    """Handle SIGTERM, Ctrl-C and a closed terminal (except under nohup) by a `Stop` in this context."""
    stop = Stop()
    with on_stop_signals(stop.handle):
        yield stop


def run_logged(
    command: Sequence[str],
    log: pathlib.Path,
    stop: Stop,
    *,
    given: bytes = b"",
    environment: Mapping[str, str] | None = None,
) -> str | None:
    """Run a command to its end, or until a stop is requested, and append its output to `log`.

    Args:
        given: standard input of the command.
        environment: environment variables of the command, by default those of this process.

    Returns:
        None if the command succeeded; otherwise the last line of its output and its exit code.
    """
    with log.open("ab") as file:
        # In a new session, so that Ctrl-C in the terminal reaches it only through `stop`.
        process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=file, stderr=file, env=environment, start_new_session=True
        )
        assert process.stdin is not None
        with contextlib.suppress(BrokenPipeError), process.stdin:  # the process died, which its exit code shows
            process.stdin.write(given)
        code = stop.wait(process)
    if code == 0:
        return None
    printed = [line.strip() for line in log.read_text(errors="replace").splitlines() if line.strip()]
    return f"{printed[-1] if printed else 'no output'} (exit code {code}; see {log})"


class Stopped(Exception):
    """A signal ended the work."""

    def __init__(self, number: int):
        super().__init__(f"stopped by signal {number}")
        self.number = number


def run_script(name: str, work: Callable[[Stop], bool]) -> int:
    """Do the work of a script and return its exit code.

    Args:
        name: name of the script, for messages.
        work: function that stops at a signal and returns whether every run is done.

    Returns:
        0, 1 if a run failed, 2 for a mistake of the user, 128 + the number of the signal that stopped it.
    """
    try:
        with stop_signals() as stop:
            return 0 if work(stop) else 1
    except UserError as error:
        sys.stderr.write(f"{name}: {error}\n")
        return 2
    except Stopped as stopped:
        sys.stderr.write("stopped; the same command continues\n")
        return 128 + stopped.number


def add_options(parser: argparse.ArgumentParser, page: str, size: str) -> None:
    """Add the options that the scripts have in common to a parser, with the default page and size."""
    add = parser.add_argument
    add("--size", default=size, choices=SIZES, help=f"size of the models (default: {size})")
    add("--seeds", help="number of seeds, or a list such as 0,5,7 (default: 3, or that of a study)")
    add("--out", type=pathlib.Path, help=f"file of the page (default: {page})")
    add("--workdir", type=pathlib.Path, default=WORKDIR, help=f"folder of all runs (default: {WORKDIR})")
    add("--jobs", type=positive, default=1, help="number of runs at once, each on a part of the cores")
    add("--no-train", action="store_true", help="evaluate existing runs only")


# Function that trains a run if it is not finished, and scores it: (request, run, number of the worker, stop). It raises
# a UserError with the reason where it fails.
Perform: TypeAlias = Callable[[Request, Run, int, Stop], None]


def run_all(
    runs: Sequence[Run], perform: Callable[[Run, int, Stop], None], stop: Stop, title: str, jobs: int = 1
) -> dict[str, str]:
    """Execute runs, `jobs` at once; a run that fails does not end the others.

    Args:
        runs: runs in the order in which they start.
        perform: function that carries out one run: (run, number of the worker, stop), see `Perform`.
        title: title of the progress bar.

    Returns:
        Name of a run that failed -> reason in one line.

    Raises:
        Stopped: a signal came; the progress of the runs is saved.
    """
    failures: dict[str, str] = {}
    watch = _Watch(runs, title)
    idle = list(range(jobs))
    queue = list(runs)
    working: dict[concurrent.futures.Future, tuple[Run, int, float]] = {}
    with contextlib.closing(watch), concurrent.futures.ThreadPoolExecutor(jobs) as threads:
        while queue or working:
            while queue and idle and stop.number is None:
                run, worker = queue.pop(0), idle.pop(0)
                working[threads.submit(perform, run, worker, stop)] = run, worker, time.monotonic()
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


def perform_in_process(request: Request, run: Run, worker: int, stop: Stop) -> None:
    """Train and score one run in a separate process, whose output goes to RUN.log beside the workdir.

    Raises:
        UserError: the process failed; the message is its last line of output.
    """
    cores = _cores(worker, request.jobs)
    values = request._asdict() | {"workdir": str(request.workdir.resolve())}
    given = json.dumps({"request": values, "run": run.name, "cores": cores}).encode()
    environment = _environment(request, len(cores), os.environ)
    log = run.workdir.with_name(f"{run.name}.log")
    error = run_logged([*_WORKER, run.name], log, stop, given=given, environment=environment)
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
    folders = [str(pathlib.Path(__file__).parents[1]), environment.get("PYTHONPATH", "")]
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
    return defaults | dict(environment) | {"PYTHONPATH": os.pathsep.join(filter(None, folders))}


class _Watch:
    """A progress bar of the steps of all runs, and a line for each run that ends."""

    def __init__(self, runs: Sequence[Run], title: str):
        self._steps = {run.name: int(run.config.train.steps) for run in runs}
        self._done = {run.name: last_step(run) for run in runs}
        self._before = sum(self._done.values())
        self._start = time.monotonic()
        self._count = 0
        total = sum(self._steps.values())
        self._bar = progress_bar(title, total, "step", initial=self._before, line_seconds=60)

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


def duration(seconds: float) -> str:
    """Format seconds, such as "41 s", "12 min" or "3 h 20 min"."""
    if seconds < 60:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"


def main() -> int:
    """Carry out the task on the standard input, {"request", "run", "cores"}, and return the exit code."""
    from ha2g_jax.launch import prepare_process

    prepare_process()
    threading.Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()
    task = json.load(sys.stdin)
    if task["cores"]:
        os.sched_setaffinity(0, task["cores"])  # before JAX counts the cores
    values: dict[str, Any] = task["request"]
    try:
        _train_and_score(
            Request(**(values | {"workdir": pathlib.Path(values["workdir"]), "seeds": tuple(values["seeds"])})),
            task["run"],
        )
    except UserError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    return 0


def _end_with(parent: int) -> None:
    """End this process at once when its parent has ended, perhaps because it was killed; the run is resumed later."""
    while os.getppid() == parent:
        time.sleep(_LOOK_EVERY)
    os._exit(1)


def _train_and_score(request: Request, name: str) -> None:
    from ha2g_jax.train.loop import train
    from tables import scores

    plan = look_aheads.plan_settings(request) if request.table == look_aheads.TABLE else plan_table(request)
    runs = (*plan.runs, plan.autoencoder) if isinstance(plan, TablePlan) else plan.runs
    run = next(run for run in runs if run.name == name)
    if request.has_training and not is_finished(run):
        train(run.config, run.workdir)
        if not is_finished(run):  # it was stopped
            return
    if not isinstance(plan, TablePlan):
        scores.score_look_aheads(run, plan, request.split)
    elif run != plan.autoencoder:
        scores.score_run(run, plan, request)


if __name__ == "__main__":
    sys.exit(main())
