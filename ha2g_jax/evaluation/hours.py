"""Predict the time of a run, and of the runs of Table 1, from steps that are measured on this machine."""

from collections.abc import Sequence
from typing import Any, NamedTuple

from ha2g_jax.config import presets
from ha2g_jax.config.settings import Config
from ha2g_jax.data.corpus import corpus_folder
from ha2g_jax.evaluation.charts import markdown
from ha2g_jax.evaluation.scoring import TEST_SPLITS
from ha2g_jax.progress import stage
from ha2g_jax.train import inputs
from ha2g_jax.train.measure import TimedStep

AUTOENCODER = "autoencoder"
METHODS = ("ha2g", "seq2seq", "speech2gesture", "joint_embedding", "trimodal", AUTOENCODER)

# Windows and hours of TED-Gesture and TED-Expressive by Table 5 of the paper; a tenth each is for validation and test.
_SEGMENTS, _HOURS = {"ted_gesture": 252_109, "ted_expressive": 240_447}, {"ted_gesture": 106.1, "ted_expressive": 100.8}
_SCORING = 45.0  # seconds to compute the scores of an hour of motion on two cores of a Xeon


class RunTime(NamedTuple):
    """Seconds of the parts of a run; the first four are those of `ha2g train`, the last those of its evaluation."""

    initialising: float
    compiling: float
    training: float
    validating: float
    scoring: float


def predict(config: Config, steps: int) -> tuple[RunTime, float]:
    """Predict the time of a run from `steps` steps and two batches of validation; return it and the seconds of a step.

    The data of the config are read if they exist; otherwise they are assumed to be as large as those of the paper.

    Raises:
        UserError: a setting cannot be used, or the batch does not split over the devices.
    """
    corpus = None
    if config.data.path and corpus_folder(config.data.path).exists():
        corpus = inputs.open_corpus(config)
    step = TimedStep(config, corpus)
    initialising = step.initialise()
    seconds = step.median(steps)
    windows, test = _SEGMENTS[config.skeleton] // 10, _HOURS[config.skeleton] / 10
    if corpus is not None:
        held_out = inputs.open_validation(config, step.objective.spec, corpus)
        windows = 0 if held_out is None else len(held_out)
        test = sum(entry["seconds"] for name, entry in corpus.metadata["splits"].items() if name in TEST_SPLITS) / 3600
    size = min(config.train.batch_size, windows)
    compiling, batch = step.validate() if size else (0.0, 0.0)
    passes = -(-config.train.steps // config.train.validate_every)
    validating = passes * (windows // size if size else 0) * batch
    stride = step.objective.spec.window_stride
    generating = 3600 * config.data.fps / stride * (batch / size if size else seconds / config.train.batch_size)
    scoring = 0.0 if config.method == AUTOENCODER else test * (generating + _SCORING)
    training, compiling = config.train.steps * seconds, step.compile_seconds + compiling
    return RunTime(initialising, compiling, training, validating, scoring), seconds


def table1(specs: Sequence[str], steps: int, seeds: int) -> list[dict[str, Any]]:
    """Predict the runs of Table 1 on data "DATA[:SIZE]": the auto-encoder once, and each method with several seeds.

    Returns:
        A row for each run: "data", "method", "runs", "step_seconds", and the hours "initialising", "compiling",
        "training", "validating" and "scoring" of one run, and "hours" of all its runs.
    """
    rows = []
    for spec in specs:
        for method in METHODS:
            with stage(f"measuring {method} on {spec}"):
                config = presets.parse(spec, method)
                parts, seconds = predict(config, steps)
            hours = {name: value / 3600 for name, value in parts._asdict().items()}
            runs = 1 if method == AUTOENCODER else seeds
            row = {"data": spec, "method": method, "runs": runs, "step_seconds": seconds}
            rows.append(row | hours | {"hours": runs * sum(hours.values())})
    return rows


def as_table(rows: Sequence[dict[str, Any]]) -> str:
    """Format the result of `table1` as Markdown, with the sum of each kind of data."""
    parts = RunTime._fields
    lines: list[Sequence[str]] = [("data", "method", "runs", "step s", *(f"{name} h" for name in parts), "all runs h")]
    for data in dict.fromkeys(row["data"] for row in rows):
        mine = [row for row in rows if row["data"] == data]
        for row in mine:
            hours = (f"{row[name]:.3g}" for name in (*parts, "hours"))
            lines.append((data, row["method"], str(row["runs"]), f"{row['step_seconds']:.3g}", *hours))
        total = sum(row["hours"] for row in mine)
        lines.append((data, "Table 1", str(sum(row["runs"] for row in mine)), *[""] * 6, f"{total:.3g}"))
    return markdown(lines)
