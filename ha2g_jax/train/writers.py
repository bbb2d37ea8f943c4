"""Write the metrics of a run to `metrics.jsonl`, TensorBoard event files and, optionally, Weights & Biases."""

import contextlib
import pathlib
import time
from collections.abc import Sequence
from typing import Any, Protocol

from ha2g_jax.checkpoint.model_folder import config_to_json
from ha2g_jax.config.settings import Config
from ha2g_jax.errors import UserError
from ha2g_jax.train import run_record
from ha2g_jax.train.metrics_file import METRICS, MetricsFile
from ha2g_jax.train.writing import writing

EVENTS = "tensorboard"

# Weights & Biases would take any time to send the rest, but a run that is stopped has half a minute. What was not sent
# is kept in the workdir, for `wandb sync`.
_WANDB_PATIENCE = 15.0  # seconds


class Destination(Protocol):
    """A destination of metrics."""

    def write(self, step: int, metrics: dict[str, float]) -> None:
        """Write the metrics of a step."""
        ...

    def close(self) -> None:
        """Finish writing."""
        ...


class Writer:
    """Write every line of metrics to each of several destinations, in order.

    Args:
        destinations: destinations of the metrics.
    """

    def __init__(self, destinations: Sequence[Destination]):
        self._destinations = destinations

    def write(self, step: int, metrics: dict[str, float]) -> None:
        """Write one line immediately, so that a run can be watched.

        Args:
            step: number of the step.
            metrics: values by name.

        Raises:
            UserError: a file cannot be written, for example because the disk is full.
        """
        for destination in self._destinations:
            destination.write(step, metrics)

    def close(self) -> None:
        """Close all destinations."""
        for destination in self._destinations:
            destination.close()


def open_writers(workdir: pathlib.Path, step: int, config: Config, is_first: bool) -> Writer:
    """Return the writer of a run that starts, or continues, at a step.

    Lines that a stopped run wrote for later steps are removed or hidden, because the run will write them again.

    Args:
        workdir: folder of the run, which exists.
        step: step of the checkpoint that the run continues from, 0 for a new run.
        config: settings of the run.
        is_first: whether this host is the first one; the writers of other hosts write nothing.

    Raises:
        UserError: a file cannot be written, or Weights & Biases is switched on but cannot be reached.
    """
    if not is_first:
        return Writer(())
    destinations: list[Destination] = [MetricsFile(workdir / METRICS, step)]
    if config.train.wandb:
        destinations.append(WandbRun(workdir, config))
    return Writer([*destinations, EventFile(workdir / EVENTS, step)])


class EventFile:
    """Add a TensorBoard event file to a folder; the names of metrics become tags.

    The `SummaryWriter` of tensorboardX writes in a thread that a full disk ends without a message; its queue then fills
    up and training waits for ever. The `EventsWriter` used here writes in the calling thread.

    Args:
        folder: folder of the event files of all starts of the run; created if it does not exist.
        step: step at which the run starts; TensorBoard hides later steps of older files.
    """

    def __init__(self, folder: pathlib.Path, step: int):
        # Imported here, because it imports PyTorch if that is installed.
        from tensorboardX.event_file_writer import EventsWriter
        from tensorboardX.proto import event_pb2, summary_pb2

        self._folder = folder
        self._events: Any = event_pb2  # the classes of both modules are made at run time
        self._summaries: Any = summary_pb2
        with writing(folder):
            folder.mkdir(exist_ok=True)
            # A unique name in the order of time: by the library's default two starts in one second share a file.
            self._file = EventsWriter(str(folder / "events"), f".{time.time_ns()}")
            self._add(step + 1, session_log=self._events.SessionLog(status=self._events.SessionLog.START))

    def write(self, step: int, metrics: dict[str, float]) -> None:
        """Write one event with all metrics of a step."""
        values = [self._summaries.Summary.Value(tag=name, simple_value=value) for name, value in metrics.items()]
        with writing(self._folder):
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

    Args:
        workdir: folder of the run, whose name becomes that of the W&B run; its `run.json` stores the id.
        config: settings of the run, which are reported too.

    Raises:
        UserError: the package is not installed, or there is no access to the project.
    """

    def __init__(self, workdir: pathlib.Path, config: Config):
        project = config.train.wandb
        try:
            import wandb
            import wandb.errors
        except ImportError as error:
            raise UserError(
                f"config.train.wandb is {project!r} but Weights & Biases is not installed: "
                "pip install 'ha2g-jax[wandb]', or leave --config.train.wandb empty"
            ) from error
        try:
            self._run = wandb.init(
                project=project,
                id=run_record.wandb_id(workdir),
                name=workdir.resolve().name,
                resume="allow",
                dir=workdir,
                config=config_to_json(config),
                allow_val_change=True,  # settings such as `train.steps` may change when a run continues
                settings=wandb.Settings(console="off", finish_timeout=_WANDB_PATIENCE),
            )
        except wandb.errors.Error as error:
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
