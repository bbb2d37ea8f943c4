"""Measure the speed of training and generation on this machine: `ha2g doctor --benchmark`."""

import copy
import statistics
import time
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ha2g_jax.config.settings import Config
from ha2g_jax.errors import UserError
from ha2g_jax.evaluation.charts import markdown
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.progress import stage
from ha2g_jax.synthesis import Model, load
from ha2g_jax.train.doctor import examine_machine
from ha2g_jax.train.measure import TimedStep

# For each precision the type of the activations, and the precision in which float32 arrays are multiplied. The second
# has an effect on accelerators only: as "tensorfloat32" an NVIDIA GPU multiplies numbers of 10 bits of mantissa.
PRECISIONS = {
    "float32": ("float32", "float32"),
    "tensorfloat32": ("float32", "tensorfloat32"),
    "bfloat16": ("bfloat16", "tensorfloat32"),
}

# Rows and columns of the matrices whose product is the peak, on a CPU and on an accelerator.
_CPU_SIZE, _ACCELERATOR_SIZE = 2048, 8192

_SPEECH_SECONDS = 60  # length of the speech for which motion is generated
_ROUNDS = 5  # timed calls of the product and of generation


def measure(config: Config, checkpoint: str, precisions: Sequence[str] | None, steps: int) -> dict[str, Any]:
    """Measure the training step of a config in several precisions, and generation with a model.

    Args:
        config: settings of the step; their type of activations is replaced.
        checkpoint: "demo", a workdir or a model folder, for generation.
        precisions: names in `PRECISIONS`; None for those that are worth measuring on the available devices.
        steps: number of timed steps of each, after one that is not timed.

    Returns:
        {"config", "machine": a text for each check of the machine, "training": for each precision the batch size,
        number of devices, seconds to compile and of a step (median), hours of all steps of a run, windows per second,
        floating-point operations of a step, peak (operations per second of a large matrix product, times the devices)
        and the share of it that a step has, "generation": seconds of speech, median seconds of a call and speed, the
        ratio of both}.

    Raises:
        UserError: a setting or the model cannot be used, or a step fails, for example for lack of memory.
    """
    model = load(checkpoint)
    if precisions is None:
        precisions = ["float32"] if jax.default_backend() == "cpu" else list(PRECISIONS)
    name, rows = f"{config.name} on {config.skeleton}", []
    for precision in precisions:
        try:
            with stage(f"compiling and measuring the step of {name} in {precision}"):
                rows.append(_measure_step(config, precision, steps))
        except jax.errors.JaxRuntimeError as error:
            reason = str(error).splitlines()[0]
            raise UserError(f"the step in {precision} fails ({reason}): lower --batch-size") from error
    with stage(f"generating {_SPEECH_SECONDS} s of motion {_ROUNDS + 1} times"):
        generation = _measure_generation(model)
    return {
        "config": name,
        "machine": {finding.name: finding.found for finding in examine_machine()},
        "training": rows,
        "generation": generation,
    }


def _measure_step(config: Config, precision: str, steps: int) -> dict[str, Any]:
    dtype, products = PRECISIONS[precision]
    config = copy.deepcopy(config)
    config.train.dtype = dtype
    with jax.default_matmul_precision(products):
        step = TimedStep(config)
        peak = _measure_peak(dtype) * step.num_devices
    seconds = step.median(steps)
    return {
        "precision": precision,
        "batch_size": step.batch_size,
        "num_devices": step.num_devices,
        "compile_seconds": step.compile_seconds,
        "step_seconds": seconds,
        "run_hours": config.train.steps * seconds / 3600,
        "windows_per_second": step.batch_size / seconds,
        "operations": step.operations,
        "peak": peak,
        "share": step.operations / seconds / peak,
    }


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


def _measure_generation(model: Model) -> dict[str, Any]:
    """Time the generation of motion from noise, which takes as long as from speech."""
    samples = np.random.default_rng(0).normal(0, 0.1, _SPEECH_SECONDS * SAMPLE_RATE).astype(np.float32)
    times = []
    for _ in range(_ROUNDS + 1):
        started = time.perf_counter()
        model.generate(samples)
        times.append(time.perf_counter() - started)
    median = statistics.median(times[1:])
    return {"speech_seconds": _SPEECH_SECONDS, "seconds": median, "speed": _SPEECH_SECONDS / median}


def as_tables(result: dict[str, Any]) -> str:
    """Format what `measure` returns as Markdown."""
    machine = [f"- {name}: {found}" for name, found in result["machine"].items()]
    head = ("precision", "devices", "batch", "compile s", "step s", "windows/s", "GFLOP a step", "TFLOP/s")
    training: list[Sequence[str]] = [(*head, "share of peak", "hours of a run")]
    for row in result["training"]:
        numbers = (
            f"{row['compile_seconds']:.1f}",
            *(f"{row[key]:.4g}" for key in ("step_seconds", "windows_per_second")),
        )
        speed = f"{row['operations'] / row['step_seconds'] / 1e12:.3g} of {row['peak'] / 1e12:.3g}"
        counts = (row["precision"], str(row["num_devices"]), str(row["batch_size"]))
        share, hours = f"{row['share']:.0%}", f"{row['run_hours']:.3g}"
        training.append((*counts, *numbers, f"{row['operations'] / 1e9:.4g}", speed, share, hours))
    row = result["generation"]
    generation = [("speech s", "seconds", "times as fast as speech")]
    generation.append((str(row["speech_seconds"]), f"{row['seconds']:.3g}", f"{row['speed']:.4g}"))
    tables = [f"Training, {result['config']}:", "", markdown(training), "", "Generation:", "", markdown(generation)]
    tables += ["", "The hours of all runs of Table 1 of the paper on this machine: ha2g doctor --benchmark --table1"]
    return "\n".join([*machine, "", *tables])
