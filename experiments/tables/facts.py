"""Facts of a report: the command, the commit, the versions, the data, and the states of the runs."""

import datetime
import importlib.metadata
import json
import pathlib
import platform
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import ha2g_jax
from ha2g_jax.data.corpus import Corpus
from ha2g_jax.errors import UserError
from ha2g_jax.train.workdir import METRICS, read_metrics
from tables.jobs import duration, last_step
from tables.plan import Run, checkpoint_step
from tables.request import Request
from tables.results import RunState

_PACKAGES = ("ha2g-jax", "jax", "jaxlib", "flax", "optax", "numpy", "scipy", "librosa")


def describe_work(
    request: Request, runs: Sequence[Run], corpus: Corpus, command: str, seconds: float
) -> dict[str, str]:
    """Describe what a report is based on: title -> text.

    Args:
        request: request of the user.
        runs: runs of the report.
        corpus: corpus of the runs.
        command: command of the user.
        seconds: time that the command has taken.
    """
    from ha2g_jax.train.run_record import commit  # JAX takes a while to import

    records = [_starts(run) for run in runs]
    trained = _distinct(start["commit"] or "unknown" for starts in records for start in starts)
    devices = _distinct(
        f"{count} x {name}"
        for starts in records
        for start in starts
        for name, count in start["hardware"]["devices"].items()
    )
    splits = [f"{name} {values['clips']:,} clips" for name, values in corpus.metadata["splits"].items()]
    now = datetime.datetime.now(datetime.UTC)
    return {
        "command": f"`{command}`",
        "time": f"{now:%Y-%m-%d %H:%M} UTC, {duration(seconds)} for what was missing",
        "commit": commit(pathlib.Path(ha2g_jax.__file__).parent) or "unknown",
        "trained with": f"commit {trained}; {devices}",
        "versions": f"Python {platform.python_version()}, {_versions()}",
        "data": f"{corpus.metadata['name']} ({corpus.metadata['source']}): {'; '.join(splits)}; "
        f"{corpus.skeleton.name}, {corpus.fps:g} frames per second",
        "size": request.size + (f", changed: {dict(request.changes)}" if request.changes else ""),
        "seeds": ", ".join(map(str, request.seeds)),
    }


def run_states(rows: Mapping[str, Sequence[Run]]) -> list[RunState]:
    """Return the states of the runs of all rows."""
    return [
        RunState(
            row=row,
            seed=run.seed,
            name=run.name,
            steps=run.config.train.steps,
            batch_size=run.config.train.batch_size,
            last_step=last_step(run),
            scored_step=(step := checkpoint_step(run)),
            validation=validation_metric(run, f"validation/{run.config.train.best_by}", step),
        )
        for row, runs in rows.items()
        for run in runs
    ]


def validation_metric(run: Run, name: str, step: int | None) -> float | None:
    """Return a metric that a run has logged on the validation split at a step, or None."""
    try:
        lines = read_metrics(run.workdir / METRICS, f'"{name}"')
    except UserError:
        return None
    return next((line[name] for line in reversed(lines) if line["step"] == step and name in line), None)


def _starts(run: Run) -> list[dict[str, Any]]:
    try:
        return json.loads((run.workdir / "run.json").read_text())["starts"]
    except (OSError, ValueError, KeyError):
        return []


def _distinct(texts: Iterable[str]) -> str:
    return ", ".join(dict.fromkeys(texts)) or "unknown"


def _versions() -> str:
    return ", ".join(f"{name} {importlib.metadata.version(name)}" for name in _PACKAGES)
