"""Beat scores of many clips at once, against a Python loop over clips, frames, angle pairs and onsets.

python benchmarks/beat_scores.py
python benchmarks/beat_scores.py --clips 1000 --rounds 5 --json

Both go from direction vectors and onsets to recall, precision, F and F with mismatched speech of every clip, and must
agree. They take turns, so that a busy machine treats both alike; ratios are of medians. Finding the onsets (librosa) is
not part of it: that depends on the sound alone, is done once and kept. The last two rows are of a loop over
clips that leaves the angles of each clip to numpy, most of whose time goes into arccos. The exit code is 1 where the
whole is not 20 times as fast as the plain loop.
"""

import argparse
import json
import math
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import tqdm

from ha2g_jax.cli.parser import positive
from ha2g_jax.metrics.beats import alignment, stops
from ha2g_jax.metrics.beats.alignment import Clip
from ha2g_jax.metrics.beats.stops import THRESHOLD
from ha2g_jax.metrics.beats.times import SIGMA
from ha2g_jax.metrics.row import SEED_FRAMES
from ha2g_jax.skeleton import Skeleton, joint_angles, load_skeleton, normalize

_FPS = 15
_LEAST_RATIO = 20
_CLIPS_PER_RECORDING = 10


def main() -> int:
    """Run the benchmark and print the table; return 1 where the whole is too slow."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clips", type=positive, default=1000)
    parser.add_argument("--frames", type=positive, nargs=2, default=(34, 300), metavar=("LEAST", "MOST"))
    parser.add_argument("--rounds", type=positive, default=3)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    result = measure(arguments.clips, tuple(arguments.frames), arguments.rounds)
    print(json.dumps(result, indent=1) if arguments.json else as_table(result))
    return 0 if result["rows"]["whole"]["ratio"] >= _LEAST_RATIO else 1


def measure(num_clips: int, frames: tuple[int, int], rounds: int) -> dict[str, Any]:
    """Return median seconds of both, part by part, after a check that they agree."""
    skeleton = load_skeleton("ted_expressive")
    motions, onsets, recordings = make_data(skeleton, num_clips, frames)
    seconds: dict[str, list[float]] = {}

    def timed(name: str, function: Callable, *inputs: Any) -> Any:
        start = time.perf_counter()
        result = function(*inputs)
        seconds.setdefault(name, []).append(time.perf_counter() - start)
        return result

    for _ in tqdm.trange(rounds, desc="rounds", disable=None, leave=False):
        rates = timed("angles", stops.angle_change_rates, skeleton, motions)
        clips, own, floor = timed("scores", scores, rates, onsets, recordings)
        loop_rates = timed("loop angles", lambda: [loop_rate(skeleton, motion) for motion in motions])
        timed("numpy angles", lambda: [numpy_rate(skeleton, motion) for motion in motions])
        partners = alignment.partners(clips, recordings)
        loop_own, loop_floor = timed("loop scores", loop_scores, loop_rates, onsets, partners)
        for rate, loop in zip(rates, loop_rates, strict=True):
            np.testing.assert_allclose(rate, loop, rtol=1e-6, atol=1e-8)
        np.testing.assert_allclose(np.stack([own.recall, own.precision, own.f], axis=1), loop_own, atol=1e-6)
        np.testing.assert_allclose(floor, loop_floor, atol=1e-6)
    parts = {
        "angles": (["angles"], ["loop angles"]),
        "scores": (["scores"], ["loop scores"]),
        "whole": (["angles", "scores"], ["loop angles", "loop scores"]),
        "angles, by numpy": (["angles"], ["numpy angles"]),
        "whole, angles by numpy": (["angles", "scores"], ["numpy angles", "loop scores"]),
    }
    rows = {}
    for name, sides in parts.items():
        ours, loop = (statistics.median(map(sum, zip(*(seconds[part] for part in side)))) for side in sides)
        rows[name] = {"seconds": ours, "loop": loop, "ratio": loop / ours}
    return {"clips": num_clips, "frames": sum(map(len, motions)), "rounds": rounds, "rows": rows}


def as_table(result: dict[str, Any]) -> str:
    """Return the result as text."""
    lines = [f"{result['clips']} clips, {result['frames']} frames, medians of {result['rounds']} rounds, both agree"]
    lines.append(f"{'':<24} {'seconds':>9} {'loop':>9} {'ratio':>8}")
    lines += [
        f"{name:<24} {row['seconds']:>9.4f} {row['loop']:>9.3f} {row['ratio']:>8.1f}"
        for name, row in result["rows"].items()
    ]
    return "\n".join(lines)


def make_data(
    skeleton: Skeleton, num_clips: int, frames: tuple[int, int]
) -> tuple[list[np.ndarray], list[np.ndarray], np.ndarray]:
    """Return motions (T, bones, 3) that sway at random, onsets of each, and the recording of each."""
    rng = np.random.default_rng(0)
    motions, onsets = [], []
    for length in rng.integers(frames[0], frames[1] + 1, num_clips):
        noise = rng.normal(size=(length + 4, skeleton.num_bones, 3))
        smooth = sum(noise[shift : shift + length] for shift in range(5)) / 5
        motions.append(normalize(skeleton.mean_directions[None] + 0.2 * smooth).astype(np.float32))
        times = np.cumsum(0.1 + rng.exponential(0.16, 1 + int(length / _FPS / 0.1)))
        onsets.append(times[times < length / _FPS])
    return motions, onsets, np.arange(num_clips) // _CLIPS_PER_RECORDING


def scores(
    rates: Sequence[np.ndarray], onsets: Sequence[np.ndarray], recordings: np.ndarray
) -> tuple[list[Clip], alignment.Alignment, np.ndarray]:
    """Compute the scores of all clips by the package, which is what is measured."""
    clips = stops.make_clips(rates, onsets, _FPS)
    return clips, alignment.align(clips), alignment.mismatched(clips, recordings)


def loop_rate(skeleton: Skeleton, motion: np.ndarray) -> list[float]:
    """Compute the angle change rate of one clip, frame by frame and pair by pair."""
    rate, before = [], None
    change = skeleton.angle_change.tolist()
    for frame in motion.tolist():
        vectors = frame + [_cross(frame[first], frame[second]) for first, second in skeleton.palms]
        lengths = [math.sqrt(_dot(vector, vector)) for vector in vectors]
        angles = []
        for first, second in skeleton.angle_pairs:
            cosine = _dot(vectors[first], vectors[second]) / (lengths[first] * lengths[second])
            angles.append(math.acos(min(max(cosine, -1.0), 1.0)) / math.pi)
        if before is not None:
            ratios = [abs(now - then) / usual for now, then, usual in zip(angles, before, change, strict=True)]
            rate.append(sum(ratios) / len(ratios))
        before = angles
    return rate


def loop_scores(
    rates: Sequence[list[float]], onsets: Sequence[np.ndarray], partners: np.ndarray
) -> tuple[list[tuple[float, float, float]], list[float]]:
    """Compute recall, precision and F, and F with mismatched speech, of one clip after the other."""
    spans = [(SEED_FRAMES / _FPS, (len(rate) + 1) / _FPS) for rate in rates]
    sounds = [
        [time - start for time in times.tolist() if start <= time < end]
        for times, (start, end) in zip(onsets, spans, strict=True)
    ]
    own, floor = [], []
    for index, rate in enumerate(rates):
        start, end = spans[index]
        moves = [time - start for time in loop_beats(rate)]
        own.append(_loop_f(moves, sounds[index]))
        others = []
        for other in partners[index].tolist():
            length = spans[other][1] - spans[other][0]
            copies = math.ceil((end - start) / length)
            repeated = [time + copy * length for copy in range(copies) for time in sounds[other]]
            others.append(_loop_f(moves, [time for time in repeated if time < end - start])[2])
        floor.append(sum(others) / len(others))
    return own, floor


def loop_beats(rate: list[float]) -> list[float]:
    """Find the motion beats of one clip: strict minima that rise enough to the nearest maximum on both sides."""
    found = []
    for middle in range(SEED_FRAMES + 1, len(rate) - 1):
        if rate[middle - 1] <= rate[middle] or rate[middle + 1] <= rate[middle]:
            continue
        left = right = middle
        while left > SEED_FRAMES and rate[left - 1] > rate[left]:
            left -= 1
        while right < len(rate) - 1 and rate[right + 1] > rate[right]:
            right += 1
        if min(rate[left], rate[right]) - rate[middle] >= THRESHOLD:
            before, after = rate[middle - 1] - rate[middle], rate[middle + 1] - rate[middle]
            found.append((middle + 0.5 * (before - after) / (before + after) + 0.5) / _FPS)
    return found


def _loop_f(moves: list[float], sounds: list[float]) -> tuple[float, float, float]:
    if not sounds:
        return math.nan, math.nan, math.nan
    if not moves:
        return 0.0, 0.0, 0.0
    r, q = (
        sum(math.exp(-(min(abs(time - other) for other in others) ** 2) / (2 * SIGMA**2)) for time in times)
        / len(times)
        for times, others in ((sounds, moves), (moves, sounds))
    )
    return r, q, 2 * r * q / (r + q) if r + q else 0.0


def numpy_rate(skeleton: Skeleton, motion: np.ndarray) -> np.ndarray:
    """Compute the angle change rate of one clip by numpy."""
    angles = joint_angles(skeleton, motion.astype(np.float64)) / np.pi
    return np.mean(np.abs(np.diff(angles, axis=0)) / skeleton.angle_change[None], axis=1)


def _dot(a: list[float], b: list[float]) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: list[float], b: list[float]) -> list[float]:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


if __name__ == "__main__":
    sys.exit(main())
