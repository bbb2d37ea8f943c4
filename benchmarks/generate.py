"""Measure how long generation takes for speech of several lengths, and the memory of the process.

python benchmarks/generate.py
python benchmarks/generate.py --config ted_expressive --seconds 10 60 600 3600 --rounds 1
python benchmarks/generate.py --config ted_expressive --seconds 60 --backend jax onnx

The speech is a file that is repeated until it is long enough. The first generation of each length compiles; the median
of the others, over the seconds of speech, is the real-time factor: below 1, motion is generated faster than speech is
spoken. Lengths are measured in ascending order, and the memory is the largest so far that the process had in use. With
two backends each round takes one after the other, so that other programs on the machine slow both alike; the memory is
then that of both, and has to be measured with each alone.
"""

import argparse
import json
import pathlib
import statistics
import sys
import tempfile
import time
from typing import Any

import numpy as np
from memory import peak_memory
from random_model import random_model

import ha2g_jax
from ha2g_jax import launch
from ha2g_jax.apps.generate import BACKENDS
from ha2g_jax.checkpoint import model_folder
from ha2g_jax.checkpoint.model_folder import LoadedModel
from ha2g_jax.cli.parser import positive
from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import SAMPLE_RATE, read_audio
from ha2g_jax.synthesis import Generator, Model

_SPEECH = pathlib.Path(__file__).parent.parent / "examples" / "hello.wav"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    source = parser.add_mutually_exclusive_group()
    source.add_argument("--config", metavar="FILE[:SIZE]", help="a model of this size with random weights")
    source.add_argument("--checkpoint", default="demo", help="'demo' (default), a workdir or a model folder")
    parser.add_argument("--speech", type=pathlib.Path, default=_SPEECH, help="file with sound")
    parser.add_argument("--seconds", type=float, nargs="+", default=[10, 60], help="lengths (default: 10 60)")
    parser.add_argument("--rounds", type=positive, default=5, help="timed generations after the first (default: 5)")
    parser.add_argument("--backend", nargs="+", choices=BACKENDS, default=["jax"], help="backends (default: jax)")
    parser.add_argument("--weights", default="float32", help="form of the weights of onnx (default: float32)")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    try:
        models = {name: load(name, arguments) for name in dict.fromkeys(arguments.backend)}
        speech = read_audio(arguments.speech)
        seconds = sorted(arguments.seconds)
        rows = [row for it in seconds for row in measure(models, speech, it, arguments.rounds)]
    except UserError as error:
        print(f"generate: {error}", file=sys.stderr)
        return 2
    print(json.dumps(rows, indent=1) if arguments.json else as_table(rows))
    return 0


def load(backend: str, arguments: argparse.Namespace) -> Generator[Any]:
    """Return the model that the arguments name, for a backend."""
    if backend == "jax" and not arguments.config:
        return ha2g_jax.load(arguments.checkpoint)
    if arguments.config:
        config = launch.load_config(arguments.config)
        loaded = LoadedModel(*random_model(config), config)
    else:
        loaded = model_folder.load(arguments.checkpoint)
    if backend == "jax":
        return Model(*loaded)
    from ha2g_jax.checkpoint.onnx.export import build
    from ha2g_jax.synthesis import load_onnx

    with tempfile.TemporaryDirectory() as folder:
        path = pathlib.Path(folder) / "model.onnx"
        path.write_bytes(build(loaded, weights=arguments.weights).SerializeToString())
        return load_onnx(path)


def measure(models: dict[str, Generator[Any]], speech: np.ndarray, seconds: float, rounds: int) -> list[dict[str, Any]]:
    """Measure the generation of motion for one length of speech.

    Args:
        models: models with trained or random weights, by the name of the backend.
        speech: (samples,) float32 mono samples at 16 kHz, repeated until they are long enough.
        seconds: length of the speech.
        rounds: number of generations after the first.

    Returns:
        For each model seconds of the first generation and the median of the others, the real-time factor, frames and
        memory.
    """
    samples = np.resize(speech, round(seconds * SAMPLE_RATE))
    times: dict[str, list[float]] = {name: [] for name in models}
    frames = 0
    for _ in range(rounds + 1):
        for name, model in models.items():
            started = time.perf_counter()
            frames = len(model.generate(samples).directions)
            times[name].append(time.perf_counter() - started)
    return [
        {
            "backend": name,
            "speech_seconds": seconds,
            "frames": frames,
            "real_time_factor": statistics.median(them[1:]) / seconds,
            "seconds": statistics.median(them[1:]),
            "least_seconds": min(them[1:]),
            "first_seconds": them[0],
            "peak_bytes": peak_memory(),
        }
        for name, them in times.items()
    ]


def as_table(rows: list[dict[str, Any]]) -> str:
    lines = [
        f"{'backend':>7} {'speech s':>9} {'real-time factor':>17} {'seconds':>9} {'least s':>9} {'first s':>9} "
        f"{'memory GiB':>11}"
    ]
    lines += [
        f"{row['backend']:>7} {row['speech_seconds']:>9g} {row['real_time_factor']:>17.4f} {row['seconds']:>9.3f} "
        f"{row['least_seconds']:>9.3f} {row['first_seconds']:>9.3f} {row['peak_bytes'] / 2**30:>11.2f}"
        for row in rows
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
