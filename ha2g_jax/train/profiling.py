"""Trace a few steps, to see where their time goes."""

import contextlib
import pathlib
import sys
from collections.abc import Iterator

import jax
import tqdm


class Profile:
    """Trace some steps of a run after the step is compiled, and stop after them.

    Args:
        folder: folder that the trace is written to; None to write no trace.
        first: number of calls of `step` before the trace begins.
        steps: number of calls of `step` in the trace.
    """

    def __init__(self, folder: pathlib.Path | None, *, first: int = 3, steps: int = 5):
        self._folder, self._first, self._last = folder, first, first + steps - 1
        self._calls = 0
        self._is_tracing = False

    @contextlib.contextmanager
    def step(self, number: int) -> Iterator[None]:
        """Mark the block that runs a step; the trace also contains what happens between two steps."""
        if self._folder is None:
            yield
            return
        if self._calls == self._first:
            self._start(self._folder)
        with jax.profiler.StepTraceAnnotation("train", step_num=number):
            yield
        if self._calls == self._last:
            self._stop(self._folder)
        self._calls += 1

    def close(self) -> None:
        """Write the trace so far if the run ends before the last traced step."""
        if self._folder is not None and self._is_tracing:
            self._stop(self._folder)
        elif self._folder is not None and self._calls <= self._first:
            _say(f"no trace: the run ended before its step {self._first + 1}; raise --config.train.steps")

    def _start(self, folder: pathlib.Path) -> None:
        options = jax.profiler.ProfileOptions()
        options.python_tracer_level = 0  # calls of Python functions would hide the rest
        jax.profiler.start_trace(folder, create_perfetto_trace=True, profiler_options=options)
        self._is_tracing = True

    def _stop(self, folder: pathlib.Path) -> None:
        jax.block_until_ready(jax.live_arrays())  # a trace contains only what the device has finished
        self._is_tracing = False
        jax.profiler.stop_trace()
        for path in sorted(folder.rglob("perfetto_trace.json.gz"))[-1:]:  # the names of the folders are times
            _say(f"trace written to {path}: open it at https://ui.perfetto.dev, or open {folder} with xprof")


def _say(line: str) -> None:
    tqdm.tqdm.write(line, file=sys.stderr)
