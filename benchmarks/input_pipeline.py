"""Measure the windows per second of the input pipeline alone, and of the train step of the same config.

python benchmarks/input_pipeline.py --config talk:paper
python benchmarks/input_pipeline.py --data runs/corpus --workers 8 --step-batch 128

Windows are read with and without images, by threads of this process and by worker processes, and "cold", where every
window decodes its clip again, or "warm", where all clips are in memory, as after an epoch. The train step takes random
data with a batch size of its own (--step-batch), which must fit on the device. The exit code is 1 where the warm
pipeline is not 5 times as fast as the step.
"""

import argparse
import copy
import itertools
import json
import pathlib
import sys
import tempfile
import time
from typing import Any

import tqdm

from ha2g_jax import launch
from ha2g_jax.cli.parser import positive
from ha2g_jax.config.settings import Config
from ha2g_jax.data.batches import batches
from ha2g_jax.data.corpus import TRAIN, Corpus
from ha2g_jax.data.talk import build
from ha2g_jax.data.windows import Windows
from ha2g_jax.errors import UserError

_LEAST_RATIO = 5
_STEPS = 3
_IDENTITIES = ("images", "speakers")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--config", default="talk", metavar="DATA[:SIZE]")
    parser.add_argument("--data", type=pathlib.Path, help="folder of a corpus (default: six new minutes of Talk)")
    parser.add_argument("--batches", type=positive, default=20, help="batches of each measurement (default: 20)")
    parser.add_argument("--workers", type=positive, default=2, help="number of worker processes (default: 2)")
    parser.add_argument("--step-batch", type=positive, default=4, help="batch size of the train step (default: 4)")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    try:
        config = launch.load_config(arguments.config)
        with tempfile.TemporaryDirectory() as folder:
            path = arguments.data or pathlib.Path(folder) / "talk"
            if not arguments.data:
                build.make_talk(path, speakers=4, minutes=6, seed=0)
            result = measure(config, Corpus.open(path), arguments)
    except UserError as error:
        print(f"input_pipeline: {error}", file=sys.stderr)
        return 2
    print(json.dumps(result, indent=1) if arguments.json else as_table(result))
    return 0 if min(result["ratios"].values()) >= _LEAST_RATIO else 1


def measure(config: Config, corpus: Corpus, arguments: argparse.Namespace) -> dict[str, Any]:
    """Measure the pipeline and the train step.

    Args:
        config: config of the data and of the step.
        corpus: corpus to read.
        arguments: arguments of the script.

    Returns:
        Windows per second of each way to read ("rows") and of the step, and the ratio of the fastest warm pipeline.
    """
    rows, size, clips_per_second = [], 0, 0.0
    for identity in _IDENTITIES:
        start = time.perf_counter()
        windows = _windows(config, corpus, identity)
        clips_per_second = len(corpus.clips(TRAIN)) / (time.perf_counter() - start)
        size = min(config.train.batch_size, len(windows))
        for workers, clips in itertools.product((0, arguments.workers), ("cold", "warm")):
            speed = _pipeline_speed(windows, size, workers, clips, arguments.batches)
            rows.append({"identity": identity, "workers": workers, "clips": clips, "windows_per_second": speed})
    # After the pipeline: JAX's threads would take part of its cores.
    steps = {identity: _step_speed(config, corpus, identity, arguments.step_batch) for identity in _IDENTITIES}
    warm = [row for row in rows if row["clips"] == "warm"]
    return {
        "index_clips_per_second": clips_per_second,
        "batch": size,
        "rows": rows,
        "step_batch": arguments.step_batch,
        "steps": steps,
        "ratios": {
            identity: max(row["windows_per_second"] for row in warm if row["identity"] == identity) / step
            for identity, step in steps.items()
        },
    }


def as_table(result: dict[str, Any]) -> str:
    lines = [f"{'identity':<10} {'read by':<12} {'clips':<6} {'batch':>5} {'windows/s':>11} {'x step':>8}"]
    for row in result["rows"]:
        readers = f"{row['workers']} processes" if row["workers"] else "threads"
        speed = row["windows_per_second"]
        ratio = speed / result["steps"][row["identity"]]
        lines.append(
            f"{row['identity']:<10} {readers:<12} {row['clips']:<6} {result['batch']:>5} {speed:>11.1f} {ratio:>8.1f}"
        )
    for identity, speed in result["steps"].items():
        lines.append(f"{identity:<10} {'train step':<12} {'':<6} {result['step_batch']:>5} {speed:>11.2f} {1:>8}")
    return "\n".join([*lines, "", f"index of a split: {result['index_clips_per_second']:.0f} clips a second"])


def _windows(config: Config, corpus: Corpus, identity: str) -> Windows:
    return Windows(
        corpus,
        TRAIN,
        corpus.vocabulary(),
        num_frames=config.data.num_frames,
        num_reference_images=config.data.num_reference_images,
        image_size=config.data.image_size if identity == "images" else None,
        cache_bytes=int(config.data.cache_gib * 2**30),
    )


def _pipeline_speed(windows: Windows, size: int, workers: int, clips: str, count: int) -> float:
    iterator = batches(windows.with_cache(0) if clips == "cold" else windows, size, seed=0, workers=workers)
    readers = max(workers, 1)
    # The first batches include imports and empty buffers; after two epochs of each reader all clips are in memory.
    skipped = 2 * readers + (2 * readers * (len(windows) // size + 1) if clips == "warm" else 0)
    bar = tqdm.tqdm(total=skipped + count, desc=f"{clips}, {workers} workers", unit="batch", leave=False)
    try:
        for _ in range(skipped):
            next(iterator)
            bar.update()
        start = time.perf_counter()
        for _ in range(count):
            next(iterator)
            bar.update()
        return size * count / (time.perf_counter() - start)
    finally:
        bar.close()
        iterator.close()


def _step_speed(config: Config, corpus: Corpus, identity: str, size: int) -> float:
    from ha2g_jax.train.measure import TimedStep  # worker processes import this file, but need no JAX

    config = copy.deepcopy(config)
    config.model.identity.kind = identity
    config.train.batch_size, config.train.devices = size, 1
    print(f"compiling the train step with {identity}", file=sys.stderr)
    step = TimedStep(config, corpus)
    step.run()
    return size * _STEPS / sum(step.run() for _ in range(_STEPS))


if __name__ == "__main__":
    sys.exit(main())
