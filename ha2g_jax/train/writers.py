"""The record of a run: `metrics.jsonl`, one JSON object a line, and the progress bar."""

import contextlib
import json
import math
import pathlib
import time
from collections.abc import Callable, Iterator

import jax
import tqdm

from ha2g_jax.errors import UserError
from ha2g_jax.train.step import Metrics


class MetricsWriter:
    """Appends to `metrics.jsonl`.

    Args:
        path: of the file.
        step: where the run starts. Lines of later steps, which a stopped run left after its last checkpoint, are
            dropped, because the run will write them again.
    """

    def __init__(self, path: pathlib.Path, step: int):
        kept = "".join(line for line in _lines(path) if _step(line) <= step)
        temporary = path.with_name(f"{path.name}.new")
        temporary.write_text(kept)
        temporary.replace(path)
        self._file = path.open("a", buffering=1)

    def write(self, step: int, metrics: dict[str, float]) -> None:
        """Writes one line at once, so that a run can be watched."""
        rounded = {name: float(f"{value:.6g}") for name, value in metrics.items()}
        self._file.write(json.dumps({"step": step} | rounded) + "\n")

    def close(self) -> None:
        self._file.close()


class StepLog:
    """Writes the metrics of steps, one step late, so that the device never waits for them.

    Args:
        writer: gets a line with the means since the last line.
        bar: shows progress.
        batch_size: windows a step.
        is_due: whether a line is to be written for a step.
    """

    def __init__(self, writer: MetricsWriter, bar: tqdm.tqdm, batch_size: int, is_due: Callable[[int], bool]):
        self._writer, self._bar, self._batch_size, self._is_due = writer, bar, batch_size, is_due
        self._waiting: tuple[int, Metrics] | None = None
        self._lines: list[dict[str, float]] = []
        self._start = time.perf_counter()
        self._seconds, self._timed_steps, self._is_compiled = 0.0, 0, False

    @contextlib.contextmanager
    def timed(self) -> Iterator[None]:
        """Counts the time of one step; not of the first, which is spent on compiling it."""
        start = time.perf_counter()
        yield
        if self._is_compiled:
            self._seconds += time.perf_counter() - start
            self._timed_steps += 1
        self._is_compiled = True

    def add(self, step: int, metrics: Metrics) -> None:
        """Takes the metrics of a step, and deals with those of the one before."""
        self.flush()
        self._waiting = (step, metrics)

    def flush(self) -> None:
        """Waits for the step that was added last and deals with its metrics.

        Raises:
            UserError: one of them is not finite.
        """
        if self._waiting is None:
            return
        (step, waiting), self._waiting = self._waiting, None
        metrics = {name: float(value) for name, value in jax.device_get(waiting).items()}
        if bad := [name for name, value in metrics.items() if not math.isfinite(value)]:
            raise UserError(
                f"{', '.join(bad)} not finite at step {step}: start anew in another workdir with a lower "
                "--config.train.learning_rate; the last checkpoint is still good"
            )
        self._lines.append(metrics)
        self._bar.update()
        if self._is_due(step):
            self._write(step)

    def _write(self, step: int) -> None:
        means = {name: sum(line[name] for line in self._lines) / len(self._lines) for name in self._lines[0]}
        speed = self._timed_steps * self._batch_size / self._seconds if self._seconds else 0.0
        times = {"windows_per_second": speed, "seconds": time.perf_counter() - self._start}
        self._writer.write(step, means | times)
        self._bar.set_postfix_str(f"huber {means['loss/huber']:.4f}, {speed:.0f} windows/s")
        self._lines, self._seconds, self._timed_steps = [], 0.0, 0


def read_metrics(path: pathlib.Path) -> list[dict[str, float]]:
    """The lines of a `metrics.jsonl`.

    Raises:
        UserError: there is none.
    """
    if not path.is_file():
        raise UserError(f"no metrics in {path}; expected the metrics.jsonl of a workdir")
    return [json.loads(line) for line in _lines(path)]


def _lines(path: pathlib.Path) -> list[str]:
    """Whole lines only: a run that was killed may leave half of one."""
    lines = path.read_text().splitlines(keepends=True) if path.exists() else []
    return [line for line in lines if line.endswith("}\n")]


def _step(line: str) -> int:
    return json.loads(line)["step"]
