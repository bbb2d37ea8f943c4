"""Measure how long generation takes for speech of several lengths, and the memory of the process.

python benchmarks/generate.py
python benchmarks/generate.py --config ted_expressive --seconds 10 60 600 3600 --rounds 1

The speech is a file that is repeated until it is long enough. The first generation of each length compiles; the median
of the others, over the seconds of speech, is the real-time factor: below 1, motion is generated faster than speech is
spoken. Lengths are measured in ascending order, and the memory is the largest so far that the process had in use.
"""

import argparse
import json
import pathlib
import resource
import statistics
import sys
import time
from typing import Any

import numpy as np
from random_model import random_model

import ha2g_jax
from ha2g_jax import launch
from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import SAMPLE_RATE, read_audio
from ha2g_jax.synthesis import Model

_SPEECH = pathlib.Path(__file__).parent.parent / "examples" / "hello.wav"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    source = parser.add_mutually_exclusive_group()
    source.add_argument("--config", metavar="FILE[:SIZE]", help="a model of this size with random weights")
    source.add_argument("--checkpoint", default="demo", help="'demo' (default), a workdir or a model folder")
    parser.add_argument("--speech", type=pathlib.Path, default=_SPEECH, help="file with sound")
    parser.add_argument("--seconds", type=float, nargs="+", default=[10, 60], help="lengths (default: 10 60)")
    parser.add_argument("--rounds", type=int, default=5, help="timed generations after the first (default: 5)")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    try:
        if arguments.config:
            config = launch.load_config(arguments.config)
            model = Model(*random_model(config), config)
        else:
            model = ha2g_jax.load(arguments.checkpoint)
        speech = read_audio(arguments.speech)
        rows = [measure(model, speech, seconds, arguments.rounds) for seconds in sorted(arguments.seconds)]
    except UserError as error:
        print(f"generate: {error}", file=sys.stderr)
        return 2
    print(json.dumps(rows, indent=1) if arguments.json else as_table(rows))
    return 0


def measure(model: Model, speech: np.ndarray, seconds: float, rounds: int) -> dict[str, Any]:
    """Measure the generation of motion for one length of speech.

    Args:
        model: model with trained or random weights.
        speech: (samples,) float32 mono samples at 16 kHz, repeated until they are long enough.
        seconds: length of the speech.
        rounds: number of generations after the first.

    Returns:
        Seconds of the first generation and the median of the others, the real-time factor, frames and memory.
    """
    samples = np.resize(speech, round(seconds * SAMPLE_RATE))
    times, frames = [], 0
    for _ in range(rounds + 1):
        started = time.perf_counter()
        frames = len(model.generate(samples).directions)
        times.append(time.perf_counter() - started)
    median = statistics.median(times[1:])
    return {
        "speech_seconds": seconds,
        "frames": frames,
        "real_time_factor": median / seconds,
        "seconds": median,
        "first_seconds": times[0],
        "peak_bytes": peak_memory(),
    }


def peak_memory() -> int:
    """Return the largest memory in bytes that this process has had in use."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024


def as_table(rows: list[dict[str, Any]]) -> str:
    lines = [f"{'speech s':>9} {'real-time factor':>17} {'seconds':>9} {'first s':>9} {'memory GiB':>11}"]
    lines += [
        f"{row['speech_seconds']:>9g} {row['real_time_factor']:>17.4f} {row['seconds']:>9.3f} "
        f"{row['first_seconds']:>9.3f} {row['peak_bytes'] / 2**30:>11.2f}"
        for row in rows
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
