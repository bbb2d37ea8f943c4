"""Measure the speed of writing a video relative to its length, with one and with two figures.

python benchmarks/video.py
python benchmarks/video.py --motion talk.npz --audio talk.wav --workers 2

The wall time depends on the other load of the machine. The processor time does not: twice the length of the video
divided by the processor time is the speed on two idle cores. The exit code is 1 where this speed is below 5 for one
figure.
"""

import argparse
import json
import pathlib
import sys
import tempfile
import time
from typing import Any

import numpy as np

from ha2g_jax.cli.parser import positive
from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import SAMPLE_RATE, read_audio
from ha2g_jax.motion.formats.video import write_video
from ha2g_jax.motion.motion import Motion

_SPEECH = pathlib.Path(__file__).parent.parent / "examples" / "hello.wav"
_LEAST_SPEED = 5
_CORES = 2


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--audio", type=pathlib.Path, default=_SPEECH)
    parser.add_argument(
        "--motion", type=pathlib.Path, help="an .npz (default: motion of the demo model for the speech)"
    )
    parser.add_argument("--size", type=positive, nargs=2, default=(1920, 1080), metavar=("WIDTH", "HEIGHT"))
    parser.add_argument("--workers", type=positive, default=_CORES)
    parser.add_argument("--repeat", type=positive, default=3, help="repetitions; the fastest counts (default: 3)")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    try:
        audio = read_audio(arguments.audio)
        motion = Motion.load(arguments.motion) if arguments.motion else _demo(arguments.audio)
        rows = [measure(count, motion, audio, arguments) for count in (1, 2)]
    except UserError as error:
        print(f"video: {error}", file=sys.stderr)
        return 2
    print(json.dumps(rows, indent=1) if arguments.json else as_table(rows))
    return 0 if rows[0]["speed_on_two_cores"] >= _LEAST_SPEED else 1


def measure(count: int, motion: Motion, audio: np.ndarray, arguments: argparse.Namespace) -> dict[str, Any]:
    """Measure the time of a video with `count` figures.

    Args:
        count: number of figures.
        motion: motion of all figures.
        audio: (samples,) float32 mono sound.
        arguments: arguments of the script.
    """
    motions = {f"figure {number}": motion for number in range(1, count + 1)}
    seconds = len(audio) / SAMPLE_RATE
    walls, costs, size = [], [], 0
    with tempfile.TemporaryDirectory() as folder:
        path = pathlib.Path(folder) / "video.mp4"
        for _ in range(arguments.repeat):
            wall, cost = time.perf_counter(), time.process_time()
            write_video(path, motions, audio, size=tuple(arguments.size), workers=arguments.workers)
            walls.append(time.perf_counter() - wall)
            costs.append(time.process_time() - cost)
            size = path.stat().st_size
    return {
        "figures": count,
        "seconds": seconds,
        "wall": min(walls),
        "speed_by_wall": seconds / min(walls),
        "processor_milliseconds_a_frame": 1000 * min(costs) / (30 * seconds),
        "speed_on_two_cores": _CORES * seconds / min(costs),
        "kilobits_a_second": size * 8 / seconds / 1000,
    }


def as_table(rows: list[dict[str, Any]]) -> str:
    lines = [f"{'figures':>7} {'wall s':>7} {'x time':>7} {'CPU ms/frame':>13} {'x time on 2 cores':>18} {'kbit/s':>7}"]
    lines += [
        f"{row['figures']:>7} {row['wall']:>7.2f} {row['speed_by_wall']:>7.2f} "
        f"{row['processor_milliseconds_a_frame']:>13.2f} {row['speed_on_two_cores']:>18.2f} "
        f"{row['kilobits_a_second']:>7.0f}"
        for row in rows
    ]
    return "\n".join(lines)


def _demo(speech: pathlib.Path) -> Motion:
    import ha2g_jax

    return ha2g_jax.load("demo").generate(speech)


if __name__ == "__main__":
    sys.exit(main())
