"""The log of a run: means of the metrics, the speed and the time spent waiting for data, and where they are written.

They go to `metrics.jsonl`, to event files of TensorBoard and, if the config says so, to Weights & Biases.
"""

import contextlib
import importlib.util
import math
import pathlib
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

import jax
import tqdm

from ha2g_jax.checkpoint.model_folder import config_to_json
from ha2g_jax.config.settings import Config
from ha2g_jax.errors import UserError, require
from ha2g_jax.files.reading import resolved
from ha2g_jax.files.writing import writing
from ha2g_jax.train import run_record
from ha2g_jax.train.step import Metrics
from ha2g_jax.train.workdir import CONTINUE, METRICS, append_metrics, start_metrics

EVENTS = "tensorboard"

# Without a limit, Weights & Biases waits until all is sent, but a run that is stopped has half a minute. What was not
# sent is kept in the workdir, for `wandb sync`.
_WANDB_PATIENCE = 15.0  # seconds
_STOP = "stop"
_TOTAL = "loss/total"
_NOTICEABLE = 5.0  # percent of time spent waiting from which the progress bar shows it


class NotFinite(Exception):
    """Loss terms of a step are not finite, or other metrics are not while all loss terms are."""

    def __init__(self, step: int, names: list[str]):
        super().__init__(f"{', '.join(names)} not finite at step {step}")
        self.step, self.names = step, names


class Writer:
    """Write the metrics of a run to all of its destinations; only the first host writes.

    Lines that a stopped run wrote for later steps are removed or hidden, because the run will write them again.
    TensorBoard's files are written where tensorboardX is installed.

    Args:
        step: step of the checkpoint that the run continues from, 0 for a new run.

    Raises:
        UserError: a file cannot be written, or Weights & Biases is switched on but cannot be reached.
    """

    def __init__(self, workdir: pathlib.Path, step: int, config: Config, is_first: bool):
        self._path = workdir / METRICS if is_first else None
        self._others: list[EventFile | WandbRun] = []
        if self._path is None:
            return
        start_metrics(self._path, step)
        if config.train.wandb:
            self._others.append(WandbRun(workdir, config))
        if importlib.util.find_spec("tensorboardX"):
            self._others.append(EventFile(workdir / EVENTS, step))
        else:
            tqdm.tqdm.write(
                f"no files for TensorBoard: they need pip install 'ha2g-jax[report]'; {METRICS} has the same values",
                file=sys.stderr,
            )

    def write(self, step: int, metrics: dict[str, float]) -> None:
        """Write one line immediately, so that a run can be watched.

        Raises:
            UserError: a file cannot be written, for example because the disk is full.
        """
        if self._path is not None:
            append_metrics(self._path, step, metrics)
        for other in self._others:
            other.write(step, metrics)

    def close(self) -> None:
        """Close all destinations."""
        for other in self._others:
            other.close()


class EventFile:
    """Add a TensorBoard event file to a folder; the names of metrics become tags.

    TensorBoard hides the values of older files for steps after the one at which the run starts. The `SummaryWriter` of
    tensorboardX writes in a thread that a full disk ends without a message; its queue then fills up and training waits
    for ever. The `EventsWriter` used here writes in the calling thread.
    """

    def __init__(self, folder: pathlib.Path, step: int):
        # Imported here, because it imports PyTorch if that is installed.
        from tensorboardX.event_file_writer import EventsWriter
        from tensorboardX.proto import event_pb2, summary_pb2

        self._folder = folder
        self._events: Any = event_pb2  # the classes of both modules are made at run time
        self._summaries: Any = summary_pb2
        with writing(folder, CONTINUE):
            folder.mkdir(exist_ok=True)
            # A unique name in the order of time; with the library's default, two starts in one second share a file.
            self._file = EventsWriter(str(folder / "events"), f".{time.time_ns()}")
            self._add(step + 1, session_log=self._events.SessionLog(status=self._events.SessionLog.START))

    def write(self, step: int, metrics: dict[str, float]) -> None:
        """Write one event with all metrics of a step."""
        values = [self._summaries.Summary.Value(tag=name, simple_value=value) for name, value in metrics.items()]
        with writing(self._folder, CONTINUE):
            self._add(step, summary=self._summaries.Summary(value=values))

    def _add(self, step: int, **content: Any) -> None:
        self._file.write_event(self._events.Event(wall_time=time.time(), step=step, **content))
        self._file.flush()

    def close(self) -> None:
        """Close the file."""
        with contextlib.suppress(OSError):  # everything was flushed before, or an error was raised
            self._file.close()


class WandbRun:
    """Report to the Weights & Biases project that the config names; every start of a workdir continues one run.

    The run of W&B has the name of the workdir, whose `run.json` stores its id.

    Raises:
        UserError: the package is not installed, or there is no access to the project.
    """

    def __init__(self, workdir: pathlib.Path, config: Config):
        project = config.train.wandb
        wandb = require("wandb", "wandb", by="config.train.wandb")
        errors = require("wandb.errors", "wandb")
        try:
            self._run = wandb.init(
                project=project,
                id=run_record.wandb_id(workdir),
                name=resolved(workdir).name,
                resume="allow",
                dir=workdir,
                config=config_to_json(config),
                allow_val_change=True,  # settings such as `train.steps` may change when a run continues
                settings=wandb.Settings(console="off", finish_timeout=_WANDB_PATIENCE),
            )
        except errors.Error as error:
            reason = " ".join(str(error).split())
            raise UserError(
                f"Weights & Biases refused project {project!r} ({reason}): run `wandb login`, set WANDB_MODE=offline, "
                "or leave --config.train.wandb empty"
            ) from error
        # W&B's own count of steps only increases, so that it would drop steps that are repeated after a kill.
        self._run.define_metric("*", step_metric="step")

    def write(self, step: int, metrics: dict[str, float]) -> None:
        """Report the metrics of a step."""
        self._run.log({"step": step} | metrics)

    def close(self) -> None:
        """End the report, after waiting a limited time for the rest to be sent."""
        self._run.finish()


class StepLog:
    """Write the metrics of steps, one step late, so that the device never waits for them.

    A line has the means of all metrics over the steps since the last line, and

    - `windows_per_second` over the time since the last line, without the time spent `apart`,
    - `waiting_percent`: percentage of that time in which the loop was `waiting` for data,
    - `seconds` since this log was created,
    - in the first line `compile_seconds`, the time of the first step, which is left out of the speed.

    The batch size is that of all hosts together, `shown` the loss term that the progress bar shows, and `pending` the
    `state` of the log of the run that this run continues.
    """

    def __init__(
        self,
        writer: Writer,
        bar: tqdm.tqdm,
        batch_size: int,
        is_due: Callable[[int], bool],
        shown: str = "huber",
        pending: dict[str, Any] | None = None,
    ):
        self._writer, self._bar, self._batch_size, self._is_due = writer, bar, batch_size, is_due
        self._shown, self._shown_speed = shown, ""
        self._unread: tuple[int, Metrics] | None = None
        self._num_steps: int = pending["steps"] if pending else 0
        self._sums: dict[str, float] = dict(pending["sums"]) if pending else {}
        self.is_stopping = False  # whether a step had the metric "stop": the hosts agreed that one was asked to stop
        self._start = time.perf_counter()
        self._compile_seconds: float | None = None
        self._is_compile_reported = False
        # Times of the current line; the timing begins after the first step has been read.
        self._line_start: float | None = None
        self._timed_steps, self._waited, self._apart = 0, 0.0, 0.0
        self._apart_start: float | None = None

    @contextlib.contextmanager
    def waiting(self) -> Iterator[None]:
        """Measure the time of the block that takes the next batch."""
        start = time.perf_counter()
        yield
        self._waited += time.perf_counter() - start

    @contextlib.contextmanager
    def stepping(self) -> Iterator[None]:
        """Measure the time of the block that starts a step; for the first step this is the time to compile it."""
        start = time.perf_counter()
        yield
        if self._compile_seconds is None:
            self._compile_seconds = time.perf_counter() - start

    @contextlib.contextmanager
    def apart(self) -> Iterator[None]:
        """Exclude the time of a block, such as validation, from the speed; a `flush` in the block still counts."""
        self._apart_start = time.perf_counter()
        yield
        self._apart += time.perf_counter() - self._apart_start
        self._apart_start = None

    def state(self) -> dict[str, Any]:
        """Return the sums over the steps since the last line, as plain values that JSON stores exactly; flush first."""
        return {"steps": self._num_steps, "sums": dict(self._sums)}

    def add(self, step: int, metrics: Metrics) -> None:
        """Add the metrics of a step, which may still be being computed, and process those of the previous step.

        Raises:
            NotFinite: a metric of the previous step is not finite.
        """
        self.flush()
        self._unread = (step, metrics)

    def flush(self) -> None:
        """Wait for the step that was added last, if its metrics were not processed yet, and process them.

        Raises:
            NotFinite: a metric is not finite. The means of the steps before are then written as the line of the
                previous step.
        """
        if self._unread is None:
            return
        (step, arrays), self._unread = self._unread, None
        if self._apart_start is not None:
            self._apart += time.perf_counter() - self._apart_start
        metrics = {name: float(value) for name, value in jax.device_get(arrays).items()}
        if self._apart_start is not None:
            self._apart_start = time.perf_counter()
        self.is_stopping |= bool(metrics.pop(_STOP, False))
        if bad := [name for name, value in metrics.items() if not math.isfinite(value)]:
            self._write(step - 1)
            terms = [name for name in bad if name.startswith("loss/") and name != _TOTAL]
            raise NotFinite(step, terms or bad)
        self._num_steps += 1
        self._sums = {name: self._sums.get(name, 0.0) + value for name, value in metrics.items()}
        if self._line_start is None:
            self._bar.unpause()  # the time left does not count that of compiling
            self._begin_line()
        else:
            self._timed_steps += 1
        self._show()
        if self._is_due(step):
            self._write(step)

    def _write(self, step: int) -> None:
        if not self._num_steps:
            return
        line = {name: value / self._num_steps for name, value in self._sums.items()}
        if self._compile_seconds is not None and not self._is_compile_reported:
            line["compile_seconds"] = self._compile_seconds
            self._is_compile_reported = True
        self._writer.write(step, line | self._speed() | {"seconds": time.perf_counter() - self._start})
        self._num_steps, self._sums = 0, {}
        if self._line_start is not None:
            self._begin_line()

    def _show(self) -> None:
        """Count the step in the progress bar, with the mean loss and the speed since the last line."""
        if speed := self._speed():
            self._shown_speed = f", {speed['windows_per_second'] / self._batch_size:.3g} steps/s"
            if speed["waiting_percent"] > _NOTICEABLE:
                self._shown_speed += f", {speed['waiting_percent']:.0f} % waiting for data"
        loss = self._sums[f"loss/{self._shown}"] / self._num_steps
        self._bar.set_postfix_str(f"{self._shown} loss {loss:.4f}{self._shown_speed}", refresh=False)
        self._bar.update()

    def _speed(self) -> dict[str, float]:
        if not self._timed_steps or self._line_start is None:
            return {}
        seconds = time.perf_counter() - self._line_start - self._apart
        return {
            "windows_per_second": self._timed_steps * self._batch_size / seconds,
            "waiting_percent": 100 * self._waited / seconds,
        }

    def _begin_line(self) -> None:
        self._line_start = time.perf_counter()
        if self._apart_start is not None:
            self._apart_start = self._line_start
        self._timed_steps, self._waited, self._apart = 0, 0.0, 0.0
