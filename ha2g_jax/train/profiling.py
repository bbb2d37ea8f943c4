"""A trace of a few steps, to see where their time goes."""

import contextlib
import pathlib
import sys
from collections.abc import Iterator

import jax
import tqdm


class Profile:
    """Traces some steps of a run, once the step is compiled; stops by itself after them.

    Args:
        folder: where the trace goes; None for none, and nothing is done.
        first: calls of `step` before the trace begins.
        steps: calls of `step` in it.
    """

    def __init__(self, folder: pathlib.Path | None, *, first: int = 3, steps: int = 5):
        self._folder, self._first, self._last = folder, first, first + steps - 1
        self._calls = 0
        self._is_tracing = False

    @contextlib.contextmanager
    def step(self, number: int) -> Iterator[None]:
        """Put around the call of a step; what is done between two steps is in the trace too."""
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
        """Writes what there is of a trace when a run ends before the last of its steps."""
        if self._folder is not None and self._is_tracing:
            self._stop(self._folder)
        elif self._folder is not None and self._calls <= self._first:
            _say(f"no trace: the run ended before step {self._first + 1} from its start; raise --config.train.steps")

    def _start(self, folder: pathlib.Path) -> None:
        options = jax.profiler.ProfileOptions()
        options.python_tracer_level = 0  # calls of Python functions hide the rest
        jax.profiler.start_trace(folder, create_perfetto_trace=True, profiler_options=options)
        self._is_tracing = True

    def _stop(self, folder: pathlib.Path) -> None:
        jax.block_until_ready(jax.live_arrays())  # the device is behind, and a trace is of what it has done
        self._is_tracing = False
        jax.profiler.stop_trace()
        for path in sorted(folder.rglob("perfetto_trace.json.gz"))[-1:]:  # folders are named by their time
            _say(f"a trace is in {path}: open it at https://ui.perfetto.dev, or {folder} with xprof")


def _say(line: str) -> None:
    tqdm.tqdm.write(line, file=sys.stderr)
