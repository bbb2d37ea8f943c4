"""Read the state of a run from its workdir: whether it is finished, its checkpoint, its metrics, its scores."""

import hashlib
import itertools
import json
import os
import pathlib
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from ha2g_jax.checkpoint import BEST, CHECKSUMS, CONFIG, LATEST, RUN, WEIGHTS
from ha2g_jax.config.settings import Config
from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import file_sha256
from ha2g_jax.train.workdir import METRICS, VALIDATION_PREFIX, read_metrics

_SPEED = "windows_per_second"  # over the steps since the previous line of metrics

_HASH_DIGITS = 10
_TAIL = 4096  # bytes at the end of metrics.jsonl that contain its last line


class Run(NamedTuple):
    """One training, of a row with one seed, of a point of a grid, or of the auto-encoder.

    Attributes:
        changed: settings that were requested in addition to those of the method: dotted name -> value.
    """

    name: str
    seed: int
    config: Config
    workdir: pathlib.Path
    changed: Mapping[str, Any] = {}


class Record(NamedTuple):
    """What reports need of a run.

    Attributes:
        config: settings of the training.
        starts: record of each start of the training: its commit, versions and hardware.
        last_step: last step of the training so far.
        scored_step: step of the checkpoint that is scored, None without one.
        validation: metrics of the validation split, a dict with its "step" for each time.
        scores: scores of the checkpoint, None without them.
        hours: time that the steps of the training took, without validation.
    """

    name: str
    seed: int
    config: Mapping[str, Any]
    starts: Sequence[Mapping[str, Any]]
    last_step: int
    scored_step: int | None
    validation: Sequence[Mapping[str, float]]
    scores: Mapping[str, Any] | None = None
    hours: float = 0.0

    def validated(self, term: str) -> float | None:
        """Return a term on the validation split at the step of the checkpoint that is scored, None if not logged."""
        name = f"{VALIDATION_PREFIX}{term}"
        return next((line[name] for line in self.validation if line["step"] == self.scored_step and name in line), None)


def record_of(run: Run, scores: Mapping[str, Any] | None) -> Record:
    """Read the record of a run, as far as the training has come, and add its scores."""
    try:
        lines = [line for line in read_metrics(run.workdir / METRICS) if len(line) > 1]
    except UserError:  # not begun
        lines = []
    speeds = {0: 1.0} | {int(line["step"]): line[_SPEED] for line in lines if _SPEED in line}
    seconds = [
        (step - before) * run.config.train.batch_size / speeds[step] for before, step in itertools.pairwise(speeds)
    ]
    return Record(
        run.name,
        run.seed,
        json.loads(run.config.to_json()),
        (read_stored(run.workdir / RUN) or {"starts": []})["starts"],
        last_step(run),
        checkpoint_step(run),
        [line for line in lines if any(name.startswith(VALIDATION_PREFIX) for name in line)],
        scores,
        sum(seconds) / 3600,
    )


def is_finished(run: Run) -> bool:
    """Return whether the workdir has the checkpoint of the last step of exactly this config."""
    if not (run.workdir / LATEST / str(run.config.train.steps)).is_dir():
        return False
    stored = read_stored(run.workdir / CONFIG)
    return stored is not None and without_path(stored) == without_path(json.loads(run.config.to_json()))


def without_path(config: Mapping[str, Any]) -> dict[str, Any]:
    """Return a config without the path of the corpus, which may change; the content has a hash of its own."""
    return {**config, "data": {**config["data"], "path": ""}}


def checkpoint_folder(run: Run) -> pathlib.Path | None:
    """Return the folder of the checkpoint to score, the best on the validation split or else the latest, or None."""
    for folder in (run.workdir / BEST, run.workdir / LATEST):
        steps = [path for path in folder.glob("*") if path.name.isdecimal() and (path / CHECKSUMS).is_file()]
        if steps:
            return max(steps, key=lambda path: int(path.name))
    return None


def checkpoint_step(run: Run) -> int | None:
    """Return the step of the checkpoint to score, or None without one."""
    folder = checkpoint_folder(run)
    return int(folder.name) if folder else None


def last_step(run: Run) -> int:
    """Return the last step for which a run has written metrics, or 0."""
    try:
        with (run.workdir / METRICS).open("rb") as file:
            file.seek(max(0, file.seek(0, os.SEEK_END) - _TAIL))
            lines = file.read().splitlines(keepends=True)
        return next(int(json.loads(line)["step"]) for line in reversed(lines) if line.endswith(b"\n"))
    except (OSError, ValueError, KeyError, StopIteration):
        return 0


def weights_digest(run: Run) -> str | None:
    """Return a hash of the weights to score, of a workdir or a model folder, or None without weights."""
    folder = checkpoint_folder(run)
    file = run.workdir / WEIGHTS if folder is None else folder / CHECKSUMS
    return file_sha256(file) if file.is_file() else None


def scores_file(run: Run, kind: str, causes: Sequence[Any]) -> pathlib.Path | None:
    """Return the path of scores of a run, whose name has a hash of the weights and of all else they depend on.

    Args:
        causes: values of JSON that the scores depend on, besides the checkpoint.

    Returns:
        The path, or None without a checkpoint.
    """
    weights = weights_digest(run)
    return None if weights is None else run.workdir / f"{kind}-{digest([weights, *causes])}.json"


def read_stored(path: pathlib.Path | None) -> dict[str, Any] | None:
    """Read a JSON file that a run has left, None where it is missing or was not written to its end."""
    if path is None:
        return None
    try:
        return json.loads(path.read_text())
    except (OSError, ValueError):
        return None


def digest(values: Any) -> str:
    """Return a short hash of values of JSON."""
    return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()[:_HASH_DIGITS]
