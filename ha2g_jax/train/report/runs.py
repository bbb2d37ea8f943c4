"""Training runs as their workdirs show them: settings, progress, best score and state. No weights are read."""

import datetime
import math
import os
import pathlib
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

from ha2g_jax.config.renames import with_new_names
from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import read_json, reading, reason, shown
from ha2g_jax.limits import MAX_CONFIG_BYTES, MAX_RECORD_BYTES
from ha2g_jax.train.metrics_file import METRICS, read_metrics
from ha2g_jax.train.report.series import Series, to_series
from ha2g_jax.train.workdir_lock import LOCK, is_training

RUNNING, FINISHED, FAILED, STOPPED, DAMAGED = "running", "finished", "failed", "stopped", "damaged"
STATES = (RUNNING, FINISHED, FAILED, STOPPED, DAMAGED)
VALIDATION = "validation/"

# `checkpoint.loading` has these names as well, but imports JAX, for which a list of runs should not wait.
_CONFIG, _RECORD, _FAILURE, _LATEST, _BEST = "config.json", "run.json", "failed.json", "latest", "best"
_MARKS = (_RECORD, METRICS, LOCK)  # files that a workdir has and other folders of models have not


class Best(NamedTuple):
    """The least validation score of a run.

    Attributes:
        name: metric by which the run chooses its best checkpoint, such as "loss/huber".
        value: least value on the validation split.
        step: step of the value.
    """

    name: str
    value: float
    step: int


class Run(NamedTuple):
    """A training run.

    Attributes:
        name: path of the workdir below the folder that all runs are in.
        path: workdir.
        state: one of `STATES`.
        reason: reason why a run failed or is damaged, otherwise "" or a remark.
        settings: dotted name of a setting -> its value; {} for a damaged run.
        step: last step that the run wrote metrics or a checkpoint for.
        steps: number of steps of the whole run, None for a damaged run.
        best: least validation score, None without any.
        changed: time of the last change of the metrics, or else of the workdir.
        starts: step of each start.
        corpus: folder of the corpus at the last start, "" where it is not known.
    """

    name: str
    path: pathlib.Path
    state: str
    reason: str
    settings: dict[str, Any]
    step: int
    steps: int | None
    best: Best | None
    changed: datetime.datetime
    starts: tuple[int, ...]
    corpus: str


def find_workdirs(folder: str | os.PathLike) -> list[pathlib.Path]:
    """Return a folder if it is a workdir, otherwise all workdirs below it, in the order of their names.

    Links to folders are not followed, and nothing below a workdir is searched.

    Args:
        folder: workdir, or a folder with workdirs at any depth, as those of sweeps and reproductions.

    Raises:
        UserError: there is no such folder, or no run in it.
    """
    folder = pathlib.Path(folder)
    expected = "the workdir of a run, or a folder of runs"
    with reading(folder, expected):
        is_folder, exists = folder.is_dir(), folder.exists()
        if is_folder:
            any(folder.iterdir())  # an error here; below, `os.walk` passes over folders that cannot be read
    if not is_folder:
        found = "is a file" if exists else "does not exist"
        raise UserError(f"{shown(folder)} {found}; expected {expected}")
    found = []
    for path, folders, files in os.walk(folder):
        if not set(_MARKS).isdisjoint(files):
            found.append(pathlib.Path(path))
            folders.clear()
        folders.sort()
    if not found:
        raise UserError(f"no run in {shown(folder)} or below; expected {expected}, which ha2g train writes")
    return found


def read_runs(workdirs: Iterable[pathlib.Path]) -> list[Run]:
    """Read the runs of several workdirs; those that cannot be read have the state `DAMAGED` and a reason.

    Args:
        workdirs: workdirs; one that is given twice is read once.

    Returns:
        The runs in this order, named by their paths below the folder that all are in.
    """
    resolved = list({path.resolve(): path for path in workdirs})
    top = pathlib.Path(os.path.commonpath([path.parent for path in resolved])) if resolved else pathlib.Path()
    return [_read_run(path, shown(path.relative_to(top))) for path in resolved]


def checkpoint_step(workdir: pathlib.Path) -> int | None:
    """Return the step of the checkpoint that a workdir stands for, the best or else the latest; None without any.

    Args:
        workdir: folder of a run.
    """
    return next((max(steps) for name in (_BEST, _LATEST) if (steps := _steps(workdir / name))), None)


def _read_run(path: pathlib.Path, name: str) -> Run:
    changed = _changed(path)
    try:
        settings = _read_settings(path)
        best_by, steps = settings["train.best_by"], settings["train.steps"]
        series = _scores(path)
        record = _record(path)
        state, why = _state(path, series.last_step, steps, record)
        return Run(
            name=name,
            path=path,
            state=state,
            reason=why,
            settings=settings,
            step=max([series.last_step, *_steps(path / _LATEST)]),
            steps=steps,
            best=_best(series.by_name.get(f"{VALIDATION}{best_by}"), best_by),
            changed=changed,
            starts=tuple(start["step"] for start in record),
            corpus=str(record[-1].get("corpus", {}).get("path", "")) if record else "",
        )
    except (UserError, OSError) as error:
        why = reason(error)
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        cause = f"{reason(error)} is missing" if isinstance(error, KeyError) else reason(error)
        why = f"its {_CONFIG}, {_RECORD} or {_FAILURE} is damaged or of another version ({cause})"
    return Run(name, path, DAMAGED, why.replace(f"{path}{os.sep}", ""), {}, 0, None, None, changed, (), "")


class _Scores(NamedTuple):
    by_name: dict[str, Series]
    last_step: int


def _scores(path: pathlib.Path) -> _Scores:
    """Return the validation scores of a run by name, and the last step of all its metrics, 0 without any."""
    rows = read_metrics(path / METRICS, containing=f'"{VALIDATION}') if (path / METRICS).exists() else []
    return _Scores(to_series(rows), int(rows[-1]["step"]) if rows else 0)


def _best(series: Series | None, name: str) -> Best | None:
    if series is None or not len(series.values):
        return None
    place = int(series.values.argmin())
    return Best(name, float(series.values[place]), int(series.steps[place]))


def _read_settings(path: pathlib.Path) -> dict[str, Any]:
    values = read_json(path / _CONFIG, "the config of a run", MAX_CONFIG_BYTES)
    if not isinstance(values, dict):
        raise UserError(f"{shown(path / _CONFIG)} is not the config of a run (not an object of JSON)")
    settings = _flat(with_new_names(values)[0])
    steps, best_by = settings["train.steps"], settings["train.best_by"]
    if type(steps) is not int or not isinstance(best_by, str):
        raise UserError(f"{shown(path / _CONFIG)} is not the config of a run (train.steps is {steps!r})")
    return settings


def _flat(values: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    flat = {}
    for name, value in values.items():
        flat |= _flat(value, f"{prefix}{name}.") if isinstance(value, dict) else {prefix + name: value}
    return flat


def _record(path: pathlib.Path) -> list[dict[str, Any]]:
    """Return the starts of a run; [] where the record is missing or damaged, which does not stop a run either."""
    try:
        starts = read_json(path / _RECORD, "the record of a run", MAX_RECORD_BYTES)["starts"]
    except (UserError, KeyError, TypeError):
        return []
    is_whole = isinstance(starts, list) and all(isinstance(start, dict) and "step" in start for start in starts)
    return starts if is_whole else []


def _state(path: pathlib.Path, step: int, steps: int, record: Sequence[dict[str, Any]]) -> tuple[str, str]:
    """Return the state of a run and its reason, or a remark."""
    remark = ""
    try:
        if is_training(path):
            return RUNNING, ""
    except OSError as error:
        remark = f"not known whether a process trains here ({reason(error).lower()})"
    if (path / _LATEST / str(steps)).is_dir():
        return FINISHED, ""
    if failure := (record[-1].get("failure") if record else None):
        return FAILED, str(failure["reason"])
    if (path / _FAILURE).exists():
        report = read_json(path / _FAILURE, "the report of a failed step", MAX_RECORD_BYTES)
        if report["step"] > step:  # otherwise the run was continued beyond it
            return FAILED, f"{', '.join(report['not_finite'])} not finite at step {report['step']}"
    return STOPPED, remark


def _steps(folder: pathlib.Path) -> list[int]:
    """Return the steps of the checkpoints in a folder."""
    if not folder.is_dir():
        return []
    return [int(path.name) for path in folder.iterdir() if path.name.isdecimal() and path.is_dir()]


def _changed(path: pathlib.Path) -> datetime.datetime:
    """Return the time of the last change of the metrics, or else of the workdir."""
    seconds = next((file.stat().st_mtime for file in (path / METRICS, path) if file.exists()), math.nan)
    return datetime.datetime.fromtimestamp(seconds, datetime.UTC)
