"""Measure the speed of training and generation on the machine at hand: `ha2g doctor --benchmark`."""

import copy
import statistics
import sys
import time
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ha2g_jax.config.settings import Config
from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.synthesis import Model, load
from ha2g_jax.train.measure import TimedStep, examine_machine

# For each precision the type of the activations, and the precision in which float32 arrays are multiplied. The second
# has an effect on accelerators only: as "tensorfloat32" an NVIDIA GPU multiplies numbers of 10 bits of mantissa.
PRECISIONS = {
    "float32": ("float32", "float32"),
    "tensorfloat32": ("float32", "tensorfloat32"),
    "bfloat16": ("bfloat16", "tensorfloat32"),
}

# Rows and columns of the matrices whose product is the peak, on a CPU and on an accelerator.
_CPU_SIZE, _ACCELERATOR_SIZE = 2048, 8192

_SPEECH_SECONDS = 60  # length of the speech that motion is generated for
_ROUNDS = 5  # timed calls of the product and of generation


class Training(NamedTuple):
    """Speed of the training step of a config in one precision.

    Attributes:
        precision: name in `PRECISIONS`.
        batch_size: windows in a step.
        num_devices: devices that share the step.
        compile_seconds: seconds to trace and compile the step.
        step_seconds: median seconds of a step.
        windows_per_second: windows trained on in a second.
        operations: floating-point operations of the products and convolutions of a step.
        peak: operations per second of a large matrix product in the precision, times the number of devices.
        share: operations per second of the step over the peak.
    """

    precision: str
    batch_size: int
    num_devices: int
    compile_seconds: float
    step_seconds: float
    windows_per_second: float
    operations: int
    peak: float
    share: float


class Generation(NamedTuple):
    """Speed of the generation of motion for speech of one length.

    Attributes:
        speech_seconds: length of the speech.
        seconds: median seconds of a call, without the first.
        speed: seconds of speech over seconds of computing.
    """

    speech_seconds: int
    seconds: float
    speed: float


def measure(config: Config, checkpoint: str, precisions: Sequence[str] | None, steps: int) -> dict[str, Any]:
    """Measure the training step of a config in several precisions, and generation with a model.

    Args:
        config: settings of the step; their type of activations is replaced.
        checkpoint: "demo", a workdir or a model folder, for generation.
        precisions: names in `PRECISIONS`; None for those worth measuring on the devices at hand.
        steps: number of timed steps of each, after one that is not timed.

    Returns:
        "config", "machine" (text for each check of the machine), "training" (fields of `Training` for each precision)
        and "generation" (fields of `Generation`).

    Raises:
        UserError: a setting or the model cannot be used, or a step fails, for example for lack of memory.
    """
    model = load(checkpoint)
    if precisions is None:
        precisions = ["float32"] if jax.default_backend() == "cpu" else list(PRECISIONS)
    name, rows = f"{config.name} on {config.skeleton}", []
    for precision in precisions:
        sys.stderr.write(f"compiling the step of {name} in {precision}\n")
        try:
            rows.append(_measure_step(config, precision, steps)._asdict())
        except jax.errors.JaxRuntimeError as error:
            reason = str(error).splitlines()[0]
            raise UserError(f"the step in {precision} fails ({reason}): lower --batch-size") from error
    sys.stderr.write(f"generating {_SPEECH_SECONDS} s of motion {_ROUNDS + 1} times\n")
    generation = _measure_generation(model)
    return {
        "config": name,
        "machine": {finding.name: finding.found for finding in examine_machine()},
        "training": rows,
        "generation": generation._asdict(),
    }


def _measure_step(config: Config, precision: str, steps: int) -> Training:
    dtype, products = PRECISIONS[precision]
    config = copy.deepcopy(config)
    config.train.dtype = dtype
    with jax.default_matmul_precision(products):
        step = TimedStep(config)
        peak = _measure_peak(dtype) * step.num_devices
    step.run()
    seconds = statistics.median(step.run() for _ in range(steps))
    return Training(
        precision=precision,
        batch_size=step.batch_size,
        num_devices=step.num_devices,
        compile_seconds=step.compile_seconds,
        step_seconds=seconds,
        windows_per_second=step.batch_size / seconds,
        operations=step.operations,
        peak=peak,
        share=step.operations / seconds / peak,
    )


def _measure_peak(dtype: str) -> float:
    """Return the operations per second of a large matrix product on one device, the best of several."""
    size = _CPU_SIZE if jax.default_backend() == "cpu" else _ACCELERATOR_SIZE
    matrix = jnp.ones((size, size), dtype)
    multiply = jax.jit(jnp.matmul)
    jax.block_until_ready(multiply(matrix, matrix))
    times = []
    for _ in range(_ROUNDS):
        started = time.perf_counter()
        jax.block_until_ready(multiply(matrix, matrix))
        times.append(time.perf_counter() - started)
    return 2 * size**3 / min(times)


def _measure_generation(model: Model) -> Generation:
    """Time the generation of motion from noise, which takes as long as from speech."""
    samples = np.random.default_rng(0).normal(0, 0.1, _SPEECH_SECONDS * SAMPLE_RATE).astype(np.float32)
    times = []
    for _ in range(_ROUNDS + 1):
        started = time.perf_counter()
        model.generate(samples)
        times.append(time.perf_counter() - started)
    median = statistics.median(times[1:])
    return Generation(speech_seconds=_SPEECH_SECONDS, seconds=median, speed=_SPEECH_SECONDS / median)


def as_tables(result: dict[str, Any]) -> str:
    """Format what `measure` returns as Markdown."""
    machine = [f"- {name}: {found}" for name, found in result["machine"].items()]
    training = [
        "| precision | devices | batch | compile s | step s | windows/s | GFLOP a step | TFLOP/s | share of peak |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for row in (Training(**values) for values in result["training"]):
        speed = f"{row.operations / row.step_seconds / 1e12:.3g} of {row.peak / 1e12:.3g}"
        training.append(
            f"| {row.precision} | {row.num_devices} | {row.batch_size} | {row.compile_seconds:.1f} "
            f"| {row.step_seconds:.4g} | {row.windows_per_second:.4g} | {row.operations / 1e9:.4g} | {speed} "
            f"| {row.share:.0%} |"
        )
    row = Generation(**result["generation"])
    generation = [
        "| speech s | seconds | times as fast as speech |",
        "|---|---|---|",
        f"| {row.speech_seconds} | {row.seconds:.3g} | {row.speed:.4g} |",
    ]
    return "\n".join(
        [*machine, "", f"Training, {result['config']}:", "", *training, "", "Generation:", "", *generation]
    )
