"""Measure how long a shell waits for `ha2g generate`: with an empty cache folder, in later processes, and with a video.

python benchmarks/startup.py
python benchmarks/startup.py --seconds 10 --rounds 5 --json

Every round takes a new cache folder (HA2G_CACHE), in which compiled programs are kept, so that the first command of a
round compiles and the others do not. The interpreter's own caches, such as those of numba, are used as they are.
"""

import argparse
import json
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time
from typing import Any

import numpy as np
import soundfile

from ha2g_jax.cli.parser import positive
from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import SAMPLE_RATE, read_audio

_SPEECH = pathlib.Path(__file__).parent.parent / "examples" / "hello.wav"
# What a user would set to keep compiled programs elsewhere or not at all.
_UNSET = ("JAX_COMPILATION_CACHE_DIR", "HA2G_COMPILE_CACHE")
_COMMANDS = {
    "motion, empty cache": "first.npz",
    "motion": "second.npz",
    "motion and 720-pixel video": "video",  # without a suffix: .npz and .mp4
}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--checkpoint", default="demo", help="'demo' (default), a workdir or a model folder")
    parser.add_argument("--seconds", type=float, default=10, help="length of the speech (default: 10)")
    parser.add_argument("--rounds", type=positive, default=5, help="processes of each command (default: 5)")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    try:
        rows = measure(arguments.checkpoint, arguments.seconds, arguments.rounds)
    except UserError as error:
        print(f"startup: {error}", file=sys.stderr)
        return 2
    print(json.dumps(rows, indent=1) if arguments.json else as_table(rows))
    return 0


def measure(checkpoint: str, seconds: float, rounds: int) -> list[dict[str, Any]]:
    """Return the median, least and greatest seconds of each command.

    Args:
        checkpoint: model, see `ha2g generate`.
        seconds: length of the speech.
        rounds: number of new cache folders.

    Raises:
        UserError: a command failed.
    """
    times: dict[str, list[float]] = {name: [] for name in _COMMANDS}
    samples = np.resize(read_audio(_SPEECH), round(seconds * SAMPLE_RATE))
    for _ in range(rounds):
        with tempfile.TemporaryDirectory() as folder:
            path = pathlib.Path(folder)
            soundfile.write(path / "speech.wav", samples, SAMPLE_RATE)
            for name, out in _COMMANDS.items():
                times[name].append(run(path, checkpoint, out))
    return [
        {"command": name, "seconds": statistics.median(found), "least": min(found), "most": max(found)}
        for name, found in times.items()
    ]


def run(folder: pathlib.Path, checkpoint: str, out: str) -> float:
    """Run `ha2g generate` in a process of its own and return its seconds.

    Args:
        folder: folder with speech.wav, of the cache and of the output.
        checkpoint: model.
        out: name of the output.

    Raises:
        UserError: the command failed.
    """
    command = [sys.executable, "-m", "ha2g_jax.cli", "generate", str(folder / "speech.wav")]
    command += ["--out", str(folder / out), "--checkpoint", checkpoint]
    environment = {name: value for name, value in os.environ.items() if name not in _UNSET}
    environment["HA2G_CACHE"] = str(folder / "cache")
    started = time.perf_counter()
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    seconds = time.perf_counter() - started
    if done.returncode:
        raise UserError(f"ha2g generate failed: {(done.stderr.strip().splitlines() or ['without a message'])[-1]}")
    return seconds


def as_table(rows: list[dict[str, Any]]) -> str:
    lines = [f"{'ha2g generate':28} {'seconds':>8} {'least':>7} {'most':>7}"]
    lines += [f"{row['command']:28} {row['seconds']:8.2f} {row['least']:7.2f} {row['most']:7.2f}" for row in rows]
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
