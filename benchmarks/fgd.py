"""Measure the seconds of a Frechet gesture distance (FGD): two sets of windows are encoded, and their moments compared.

python benchmarks/fgd.py
python benchmarks/fgd.py --config autoencoder:ted_gesture --rounds 5

The auto-encoder has random weights, which do not change the time, and the windows are noise. By default there are as
many windows as in the test split of TED-Gesture (HA2G, supplement).
"""

import argparse
import json
import pathlib
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from random_model import random_model

from ha2g_jax import launch
from ha2g_jax.checkpoint import model_folder
from ha2g_jax.cli.parser import positive
from ha2g_jax.errors import UserError
from ha2g_jax.evaluation.features import PoseFeatures
from ha2g_jax.metrics.frechet import distance, moments
from ha2g_jax.skeleton import Skeleton, normalize


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--config", default="autoencoder:ted_expressive", help="(default: %(default)s)")
    parser.add_argument("--windows", type=positive, default=25_930, help="windows of each set (default: 25930)")
    parser.add_argument("--rounds", type=positive, default=5, help="timed calls after the first (default: 5)")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    try:
        config = launch.load_config(arguments.config)
        _, variables, assets = random_model(config)
        with tempfile.TemporaryDirectory() as folder:
            encode = PoseFeatures(model_folder.save(pathlib.Path(folder) / "model", config, assets, variables))
        rows = measure(encode, arguments.windows, arguments.rounds)
    except UserError as error:
        print(f"fgd: {error}", file=sys.stderr)
        return 2
    print(json.dumps(rows, indent=1) if arguments.json else as_table(rows))
    return 0


def measure(encode: PoseFeatures, count: int, rounds: int) -> list[dict[str, Any]]:
    """Return the median seconds of the parts of an FGD and of the whole, which comes first.

    Args:
        encode: pose auto-encoder.
        count: number of windows of each of the two sets.
        rounds: number of timed calls.
    """
    sets = [noise(encode.skeleton, count, seed) for seed in range(2)]
    encode(sets[0][:1])  # compiles
    seconds: dict[str, list[float]] = {"encode": [], "distance": []}

    def timed(name: str, function: Callable[[], Any]) -> Any:
        started = time.perf_counter()
        result = function()
        seconds[name].append(time.perf_counter() - started)
        return result

    for _ in range(rounds):
        latents = timed("encode", lambda: [encode(windows) for windows in sets])
        timed("distance", lambda latents=latents: distance(*map(moments, latents)))
    parts = {"FGD": [sum(both) for both in zip(*seconds.values(), strict=True)]}
    parts |= {"encode two sets": seconds["encode"], "moments and distance": seconds["distance"]}
    return [
        {"part": name, "seconds": statistics.median(times), "windows": count, "latent_dim": encode.latent_dim}
        for name, times in parts.items()
    ]


def noise(skeleton: Skeleton, count: int, seed: int) -> np.ndarray:
    """Return windows (count, 34, bones, 3) of unit vectors around the mean directions."""
    random = np.random.default_rng(seed)
    shift = random.standard_normal((count, 34, skeleton.num_bones, 3), np.float32)
    return normalize(0.3 * shift + skeleton.mean_directions)


def as_table(rows: list[dict[str, Any]]) -> str:
    lines = [f"{'part':22} {'seconds':>9}", *(f"{row['part']:22} {row['seconds']:9.3f}" for row in rows)]
    return "\n".join([*lines, "", f"{rows[0]['windows']} windows in each set, {rows[0]['latent_dim']} values a latent"])


if __name__ == "__main__":
    sys.exit(main())
