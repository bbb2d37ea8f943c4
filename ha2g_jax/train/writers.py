"""Where the metrics of a run go: `metrics.jsonl`, TensorBoard event files and, if asked for, Weights & Biases."""

import contextlib
import json
import pathlib
import time
from collections.abc import Sequence
from typing import Any, Protocol

from ha2g_jax.checkpoint.model_folder import config_to_json
from ha2g_jax.config import Config
from ha2g_jax.errors import UserError
from ha2g_jax.train import run_record

METRICS, EVENTS = "metrics.jsonl", "tensorboard"

# Weights & Biases would send the rest for as long as that takes; a run that is stopped has half a minute. What was
# not sent is kept in the workdir, for `wandb sync`.
_WANDB_PATIENCE = 15.0  # seconds


class Destination(Protocol):
    """One of the places that metrics go to."""

    def write(self, step: int, metrics: dict[str, float]) -> None: ...

    def close(self) -> None: ...


class Writer:
    """Writes every line of metrics to each of `destinations`, in order."""

    def __init__(self, destinations: Sequence[Destination]):
        self._destinations = destinations

    def write(self, step: int, metrics: dict[str, float]) -> None:
        """Writes one line at once, so that a run can be watched.

        Raises:
            UserError: a file cannot be written, because the disk is full or for another reason.
        """
        for destination in self._destinations:
            destination.write(step, metrics)

    def close(self) -> None:
        for destination in self._destinations:
            destination.close()


def open_writers(workdir: pathlib.Path, step: int, config: Config, is_first: bool) -> Writer:
    """The writer of a run that starts, or goes on, at `step`.

    What a stopped run wrote of later steps is taken away or hidden, because the run will write it again.

    Args:
        workdir: folder of the run; there already.
        step: of the checkpoint that the run goes on from, 0 for a new run.
        config: of the run.
        is_first: whether this host writes; the writer of any other writes nothing.

    Raises:
        UserError: a file cannot be written, or Weights & Biases is asked for and cannot be reached.
    """
    if not is_first:
        return Writer(())
    destinations: list[Destination] = [MetricsFile(workdir / METRICS, step)]
    if config.train.wandb:
        destinations.append(WandbRun(workdir, config))
    return Writer([*destinations, EventFile(workdir / EVENTS, step)])


class MetricsFile:
    """Appends to `metrics.jsonl`: one JSON object a line, numbers with six digits.

    Args:
        path: of the file.
        step: where the run starts. Lines of later steps are dropped, and so is half a line at the end.
    """

    def __init__(self, path: pathlib.Path, step: int):
        self._path = path
        kept = [line for line in _lines(path) if line["step"] <= step]
        temporary = path.with_name(f"{path.name}.new")
        with run_record.writing(path):
            temporary.write_text("".join(json.dumps(line) + "\n" for line in kept))
            temporary.replace(path)

    def write(self, step: int, metrics: dict[str, float]) -> None:
        rounded = {name: float(f"{value:.6g}") for name, value in metrics.items()}
        # Opened for each line: nothing stays in a buffer, and on a network disk others see the line at once.
        with run_record.writing(self._path), self._path.open("a") as file:
            file.write(json.dumps({"step": step} | rounded) + "\n")

    def close(self) -> None:
        """Nothing is left to do; every line is written whole."""


class EventFile:
    """Adds a TensorBoard event file to a folder; the names of metrics become tags.

    tensorboardX's own `SummaryWriter` writes in a thread, which a full disk ends without a word: its queue then
    fills up and training waits for ever. Its `EventsWriter` writes here and now.

    Args:
        folder: of the event files of all starts of the run; made if there is none.
        step: where the run starts. TensorBoard then hides what older files have of later steps.
    """

    def __init__(self, folder: pathlib.Path, step: int):
        # Imported where a run starts, because it brings PyTorch along if that is installed.
        from tensorboardX.event_file_writer import EventsWriter
        from tensorboardX.proto import event_pb2, summary_pb2

        self._folder = folder
        self._events: Any = event_pb2  # their classes are made at run time
        self._summaries: Any = summary_pb2
        with run_record.writing(folder):
            folder.mkdir(exist_ok=True)
            # A name of its own in the order of time: two starts in one second would share the library's.
            self._file = EventsWriter(str(folder / "events"), f".{time.time_ns()}")
            self._add(step + 1, session_log=self._events.SessionLog(status=self._events.SessionLog.START))

    def write(self, step: int, metrics: dict[str, float]) -> None:
        values = [self._summaries.Summary.Value(tag=name, simple_value=value) for name, value in metrics.items()]
        with run_record.writing(self._folder):
            self._add(step, summary=self._summaries.Summary(value=values))

    def _add(self, step: int, **content: Any) -> None:
        self._file.write_event(self._events.Event(wall_time=time.time(), step=step, **content))
        self._file.flush()

    def close(self) -> None:
        with contextlib.suppress(OSError):  # all was flushed before, or the failure to do so was raised
            self._file.close()


class WandbRun:
    """Reports to the Weights & Biases project that the config names; every start of a workdir continues one run.

    Args:
        workdir: its name is the run's; `run.json` in it keeps the run's id.
        config: of the run; shown with it.

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
                allow_val_change=True,  # `train.steps` and the like may change when a run goes on
                settings=wandb.Settings(console="off", finish_timeout=_WANDB_PATIENCE),
            )
        except wandb.errors.Error as error:
            reason = " ".join(str(error).split())
            raise UserError(
                f"Weights & Biases refused project {project!r} ({reason}): run `wandb login`, set WANDB_MODE=offline, "
                "or leave --config.train.wandb empty"
            ) from error
        # Its own count of steps only goes up, so that it would drop what a run writes again after a kill.
        self._run.define_metric("*", step_metric="step")

    def write(self, step: int, metrics: dict[str, float]) -> None:
        self._run.log({"step": step} | metrics)

    def close(self) -> None:
        self._run.finish()


def read_metrics(path: pathlib.Path) -> list[dict[str, float]]:
    """The lines of a `metrics.jsonl`.

    Raises:
        UserError: there is none.
    """
    if not path.is_file():
        raise UserError(f"no metrics in {path}; expected the metrics.jsonl of a workdir")
    return _lines(path)


def _lines(path: pathlib.Path) -> list[dict[str, float]]:
    """Whole lines only: a run that was killed may leave half of one."""
    texts = path.read_text(errors="replace").splitlines(keepends=True) if path.exists() else []
    return [line for text in texts if (line := _parse(text)) is not None]


def _parse(text: str) -> dict[str, float] | None:
    try:
        line = json.loads(text) if text.endswith("\n") else None
    except ValueError:
        return None
    return line if isinstance(line, dict) and "step" in line else None
