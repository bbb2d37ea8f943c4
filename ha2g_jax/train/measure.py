"""Measure a training step: its time, memory and operations, and a trace of where time goes."""

import contextlib
import math
import pathlib
import statistics
import sys
import time
from collections.abc import Iterator
from typing import Any, NamedTuple

import jax
import numpy as np
import tqdm
from jax.extend import core

from ha2g_jax.config.settings import Config
from ha2g_jax.data.corpus import TRAIN, Corpus
from ha2g_jax.layers.cpu import onednn
from ha2g_jax.methods.method import Spec, example_batch
from ha2g_jax.skeleton import load_skeleton, normalize
from ha2g_jax.stopping import leaving_on_signals
from ha2g_jax.train import sharding
from ha2g_jax.train.objective import build_objective, init_state

# Sizes of the tables of words and speakers if no corpus is given, about those of TED.
NUM_WORDS, NUM_SPEAKERS = 20_000, 1_000


def gib(size: int) -> str:
    """Format a number of bytes, such as "1.5 GiB"."""
    return f"{size / 2**30:.1f} GiB" if size >= 2**30 / 10 else f"{size / 2**20:.1f} MiB"


class Memory(NamedTuple):
    """Memory of a compiled step on each device, in bytes."""

    arguments: int  # the state and the batch
    outputs: int  # the state and the metrics
    aliased: int  # part of the outputs that reuses the memory of arguments
    temporary: int  # all intermediate values

    @property
    def total(self) -> int:
        """Total number of bytes that the step needs."""
        return self.arguments + self.outputs - self.aliased + self.temporary


class TimedStep:
    """The training step of a config, compiled for the devices of the config but not yet run.

    The corpus determines the sizes of the tables of words and speakers; None for those of TED.

    Attributes:
        batch: the random batch, on the devices.
        batch_size: windows in a step, on all devices together.
        operations: floating-point operations of the matrix products and convolutions of a step, on all devices.
        compile_seconds: seconds to trace and compile; less if the program was in the compilation cache.
        memory: memory of the step, None if the compiler does not report it.

    Raises:
        UserError: a setting cannot be used, or the batch does not split over the devices.
    """

    def __init__(self, config: Config, corpus: Corpus | None = None, *, onednn: bool | None = None):
        skeleton = corpus.skeleton if corpus else load_skeleton(config.skeleton)
        num_words = len(corpus.vocabulary()) if corpus else NUM_WORDS
        num_speakers = len(corpus.speakers_of(TRAIN)) if corpus else NUM_SPEAKERS
        self.objective = objective = build_objective(config, skeleton, num_words, num_speakers, onednn=onednn)
        self._mesh = sharding.data_mesh(jax.devices()[: config.train.devices or None])
        self.batch_size, self.num_devices = config.train.batch_size, self._mesh.size
        sharding.check_batch_size(self.batch_size, self.num_devices)
        data = random_batch(objective.spec, self.batch_size, num_words, num_speakers)
        self.batch = sharding.shard_batch(self._mesh, data)
        self._key = jax.random.key(config.seed)
        self._state: Any = None

        started = time.perf_counter()
        self._shapes = jax.eval_shape(lambda key: init_state(objective, key), self._key)
        # The function of `compile_step` compiles when it is called; this compiles the same program from shapes alone.
        step = jax.jit(sharding.compile_step(objective, self._mesh), donate_argnums=0)
        traced = step.trace(self._shapes, self.batch, self._key)
        with leaving_on_signals():
            self._step = traced.lower().compile()
        self.compile_seconds = time.perf_counter() - started
        self.operations = count_operations(traced.jaxpr.jaxpr)
        self.memory = _memory(self._step)

    def initialise(self) -> float:
        """Initialise the networks as a run does, and return the time in seconds."""
        started = time.perf_counter()
        state = jax.block_until_ready(init_state(self.objective, self._key))
        self._state = sharding.replicate(self._mesh, state)
        return time.perf_counter() - started

    def validate(self) -> tuple[float, float]:
        """Return the seconds to compile the validation step, and those to run it on a batch; call `run` before."""
        step, seconds = sharding.compile_validation_step(self.objective, self._mesh), []
        for _ in range(2):
            started = time.perf_counter()
            with leaving_on_signals():
                jax.block_until_ready(step(self._state, self.batch, self._key))
            seconds.append(time.perf_counter() - started)
        return max(seconds[0] - seconds[1], 0.0), seconds[1]

    def median(self, steps: int, most_seconds: float = math.inf) -> float:
        """Return the median seconds of `steps` steps after the first, or of fewer once they took `most_seconds`."""
        self.run()
        started, seconds = time.perf_counter(), [self.run()]
        while len(seconds) < steps and time.perf_counter() - started < most_seconds:
            seconds.append(self.run())
        return statistics.median(seconds)

    def run(self) -> float:
        """Run one step and return its time in seconds; the first call also creates the state, which is not timed."""
        if self._state is None:
            # The time does not depend on the numbers, and the program that initialises the state compiles slowly.
            state = jax.tree.map(lambda x: np.full(x.shape, 0.01, x.dtype), self._shapes)
            self._state = sharding.replicate(self._mesh, state)
        started = time.perf_counter()
        self._state, metrics = self._step(self._state, self.batch, self._key)
        jax.block_until_ready((self._state, metrics))
        return time.perf_counter() - started


def random_batch(spec: Spec, size: int, num_words: int, num_speakers: int) -> dict[str, np.ndarray]:
    """Return noise with the shapes, types and units of a batch of `size` windows, see `ha2g_jax.data.windows`."""
    random = np.random.default_rng(0)

    def draw(name: str, shape: tuple[int, ...]) -> np.ndarray:
        match name:
            case "mel" | "asr_mel" | "audio":
                low, high = {"mel": (-80, 0), "asr_mel": (-1.5, 1.5), "audio": (-1, 1)}[name]
                return random.uniform(low, high, shape).astype(np.float32)
            case "directions":
                directions = random.normal(0, 0.3, shape) + spec.skeleton.mean_directions
                return normalize(directions.astype(np.float32))
            case "images":
                return random.integers(256, size=shape, dtype=np.uint8)
        return random.integers(num_speakers if name == "speaker" else num_words, size=shape, dtype=np.int32)

    one = jax.eval_shape(lambda: example_batch(spec))
    return {name: draw(name, (size, *array.shape[1:])) for name, array in one.items()}


def _memory(step: jax.stages.Compiled) -> Memory | None:
    found = step.memory_analysis()
    if found is None:
        return None
    return Memory(
        arguments=found.argument_size_in_bytes,
        outputs=found.output_size_in_bytes,
        aliased=found.alias_size_in_bytes,
        temporary=found.temp_size_in_bytes,
    )


class Profile:
    """Trace a few steps of a run after the step is compiled.

    The trace is written to a folder, None for no trace; it begins after `first` calls of `step` and covers `steps`.
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


def count_operations(jaxpr: core.Jaxpr) -> int:
    """Count the operations of the matrix products and convolutions of a traced function.

    A multiplication and the addition of its result are two operations. All other operations are left out: they are
    few, and limited by memory rather than by arithmetic. A loop counts as often as it runs, except a `while_loop`,
    whose number of runs is unknown and which counts once. Of the branches of a `cond` the most expensive one counts.
    """
    return sum(map(_of_equation, jaxpr.eqns))


def _of_equation(equation: core.JaxprEqn) -> int:
    match equation.primitive.name:
        case "dot_general":
            return _of_product(equation)
        case "conv_general_dilated":
            return _of_convolution(equation)
        case "ffi_call":
            shapes = [_shape(variable) for variable in (*equation.invars, *equation.outvars)]
            return onednn.count_operations(equation.params["target_name"], shapes)
    counts = [count_operations(jaxpr) for jaxpr in core.jaxprs_in_params(equation.params)]
    if equation.primitive.name == "cond":
        return max(counts)
    return sum(counts) * equation.params.get("length", 1)


def _of_product(equation: core.JaxprEqn) -> int:
    (contracted, _), _ = equation.params["dimension_numbers"]
    left = _shape(equation.invars[0])
    return 2 * math.prod(_shape(equation.outvars[0])) * math.prod(left[axis] for axis in contracted)


def _of_convolution(equation: core.JaxprEqn) -> int:
    """Count a convolution; of one with a dilated input, as in a gradient, the products with its zeros are left out."""
    numbers, dilation = equation.params["dimension_numbers"], equation.params["lhs_dilation"]
    kernel = _shape(equation.invars[1])
    taps = math.prod(kernel[axis] for axis in numbers.rhs_spec[1:])  # inputs, height and width
    return 2 * math.prod(_shape(equation.outvars[0])) * taps // math.prod(dilation)


def _shape(variable: Any) -> tuple[int, ...]:
    return variable.aval.shape
