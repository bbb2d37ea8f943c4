"""Training runs as their workdirs show them: state, progress, best score, and the settings in which they differ."""

import datetime
import json
import math
import os
import pathlib
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

from ha2g_jax.checkpoint import CONFIG, FAILED, LATEST, RUN
from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import read_json, reading, reason, resolved, shown
from ha2g_jax.limits import MAX_CONFIG_BYTES, MAX_RECORD_BYTES
from ha2g_jax.train.workdir import LOCK, METRICS, VALIDATION_PREFIX, is_training, read_metrics

STATES = RUNNING, FINISHED, FAILING, STOPPED, DAMAGED = ("running", "finished", "failed", "stopped", "damaged")
SEED = "seed"

_ABSENT = "-"  # shown for a setting that a run does not have
_MOST_COLUMNS, _MOST_LETTERS = 8, 24  # settings of the table, and letters of a value; the JSON has all of them
_MOST_IN_LABEL = 3  # settings that a label names; lines with more differences are named after their runs


class Best(NamedTuple):
    """The least validation score of a run, and the step at which it was reached."""

    name: str
    value: float
    step: int


class Run(NamedTuple):
    """A training run.

    Attributes:
        state: one of `STATES`.
        reason: reason why a run failed or is damaged, otherwise "" or a remark.
        settings: dotted name of a setting -> its value; {} for a damaged run, and before the first step is prepared.
        step: last step that the run wrote metrics or a checkpoint for.
        steps: number of steps of the whole run, None where there are no settings.
        best: least validation score of the metric that chooses the best checkpoint, None without any.
        changed: time of the last change of the metrics, or else of the workdir.
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


class Line(NamedTuple):
    """Runs that are one line of a chart: one, or several with distinct seeds and otherwise equal configs."""

    label: str
    runs: tuple[Run, ...]


# Name of an order of the rows -> the key by which they are sorted, so that the most wanted come first.
SORTS: dict[str, Callable[[Run], Any]] = {
    "name": lambda run: 0,
    "step": lambda run: -run.step,
    "best": lambda run: math.inf if run.best is None else run.best.value,
    "state": lambda run: STATES.index(run.state),
    "changed": lambda run: -run.changed.timestamp(),
}


def list_runs(folders: Sequence[str | os.PathLike], sort: str = "name") -> list[Run]:
    """Return all runs in some folders, at any depth, in the order of one of `SORTS`.

    Raises:
        UserError: there is no such folder, or no run below one.
    """
    runs = read_runs(path for folder in folders for path in find_workdirs(folder))
    return sorted(sorted(runs, key=lambda run: run.name), key=SORTS[sort])


def find_workdirs(folder: str | os.PathLike) -> list[pathlib.Path]:
    """Return a folder if it is a workdir, otherwise all workdirs below it, in the order of their names.

    Links to folders are not followed, and nothing below a workdir is searched.

    Raises:
        UserError: there is no such folder, or no run in it.
    """
    folder = pathlib.Path(folder)
    expected = "the workdir of a run, or a folder of runs"
    with reading(folder, expected):
        if folder.is_dir():
            any(folder.iterdir())  # an error here; below, `os.walk` passes over folders that cannot be read
        else:
            found = "is a file" if folder.exists() else "does not exist"
            raise UserError(f"{shown(folder)} {found}; expected {expected}")
    found = []
    for path, folders, files in os.walk(folder):
        if not {RUN, METRICS, LOCK}.isdisjoint(files):  # a folder of a model has none of them
            found.append(pathlib.Path(path))
            folders.clear()
        folders.sort()
    if not found:
        raise UserError(f"no run in {shown(folder)} or below; expected {expected}, which ha2g train writes")
    return found


def read_runs(workdirs: Iterable[pathlib.Path]) -> list[Run]:
    """Read the runs of several workdirs, each once; those that cannot be read have the state `DAMAGED` and a reason.

    Runs are named by their paths below their common folder.
    """
    paths = list({resolved(path): path for path in workdirs})
    top = pathlib.Path(os.path.commonpath([path.parent for path in paths])) if paths else pathlib.Path()
    return [_read_run(path, shown(path.relative_to(top))) for path in paths]


def _read_run(path: pathlib.Path, name: str) -> Run:
    file = path / METRICS if (path / METRICS).exists() else path
    changed = datetime.datetime.fromtimestamp(file.stat().st_mtime, datetime.UTC)
    if not any((path / name).exists() for name in (CONFIG, RUN, METRICS, LATEST)):  # only the lock of a start
        return Run(name, path, *_state(path, 0, 0), {}, 0, None, None, changed)
    try:
        settings = _flat(read_json(path / CONFIG, "the config of a run", MAX_CONFIG_BYTES))
        best_by, steps = settings["train.best_by"], settings["train.steps"]
        rows = read_metrics(path / METRICS, f'"{VALIDATION_PREFIX}') if (path / METRICS).exists() else []
        logged = int(rows[-1]["step"]) if rows else 0
        step = max([logged, *_checkpoints(path / LATEST)])
        scores = [(row[VALIDATION_PREFIX + best_by], row["step"]) for row in rows if VALIDATION_PREFIX + best_by in row]
        least = min((score for score in scores if math.isfinite(score[0])), default=None)
        best = Best(best_by, least[0], int(least[1])) if least else None
        return Run(name, path, *_state(path, logged, steps), settings, step, steps, best, changed)
    except (UserError, OSError) as error:
        why = reason(error).replace(f"{path}{os.sep}", "")
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        why = f"its {CONFIG} or {RUN} is damaged or of another version ({reason(error)})"
    return Run(name, path, DAMAGED, why, {}, 0, None, None, changed)


def _flat(values: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    flat = {}
    for name, value in values.items():
        flat |= _flat(value, f"{prefix}{name}.") if isinstance(value, dict) else {prefix + name: value}
    return flat


def _state(path: pathlib.Path, step: int, steps: int) -> tuple[str, str]:
    """Return the state of a run and its reason, or a remark."""
    remark = ""
    try:
        if is_training(path):
            return RUNNING, ""
    except OSError as error:
        remark = f"not known whether a process trains here ({reason(error).lower()})"
    if (path / LATEST / str(steps)).is_dir():
        return FINISHED, ""
    if (path / RUN).exists():
        starts = read_json(path / RUN, "the record of a run", MAX_RECORD_BYTES)["starts"]
        if failure := (starts[-1].get("failure") if starts else None):
            return FAILING, str(failure["reason"])
    if (path / f"{FAILED}.json").exists():
        report = read_json(path / f"{FAILED}.json", "the report of a failed step", MAX_RECORD_BYTES)
        if report["step"] > step:  # otherwise the run was continued beyond it
            return FAILING, f"{', '.join(report['not_finite'])} not finite at step {report['step']}"
    return STOPPED, remark


def _checkpoints(folder: pathlib.Path) -> list[int]:
    """Return the steps of the checkpoints in a folder."""
    return [int(path.name) for path in folder.glob("*") if path.name.isdecimal() and path.is_dir()]


def differing(runs: Sequence[Run]) -> list[str]:
    """Return the settings in which runs differ, in the order of the configs; runs without settings are passed over."""
    readable = [run.settings for run in runs if run.settings]
    names = dict.fromkeys(name for settings in readable for name in settings)
    return [name for name in names if len({_key(settings.get(name, _ABSENT)) for settings in readable}) > 1]


def common_differing(runs: Sequence[Run]) -> list[str]:
    """Return the settings of `differing` that all runs have, without those that only some methods have."""
    readable = [run.settings for run in runs if run.settings]
    return [name for name in differing(runs) if all(name in settings for settings in readable)]


def short_names(names: Sequence[str]) -> dict[str, str]:
    """Return for each dotted name its shortest ending that no other name has."""
    short = {}
    for name in names:
        parts = name.split(".")
        endings = [".".join(parts[-count:]) for count in range(1, len(parts) + 1)]
        others = [f".{other}" for other in names if other != name]
        short[name] = next((end for end in endings if not any(other.endswith(f".{end}") for other in others)), name)
    return short


def make_lines(runs: Sequence[Run]) -> list[Line]:
    """Group runs into lines of a chart; runs without settings are passed over.

    Runs are one line if their configs differ in the seed and in nothing else. If two of them have the same seed, they
    differ in something that the config does not say, such as the code, and each run is a line.
    """
    groups: dict[str, list[Run]] = {}
    for run in runs:
        if run.settings:
            groups.setdefault(_key(run.settings | {SEED: None}), []).append(run)
    parts: list[tuple[Run, ...]] = []
    for group in groups.values():
        has_seeds = len({run.settings[SEED] for run in group}) == len(group)
        parts += [tuple(group)] if has_seeds else [(run,) for run in group]
    firsts = [part[0] for part in parts]
    short = short_names([name for name in common_differing(firsts) if name != SEED])
    labels = [", ".join(f"{end}={_value_text(run, name)}" for name, end in short.items()) for run in firsts]
    if not 0 < len(short) <= _MOST_IN_LABEL or len(set(labels)) < len(labels):
        labels = [part[0].name + (f" and {len(part) - 1} more" if part[1:] else "") for part in parts]
    return [Line(label, part) for label, part in zip(labels, parts, strict=True)]


def _key(value: Any) -> str:
    return json.dumps(value, sort_keys=True)


def _value_text(run: Run, name: str) -> str:
    value = run.settings.get(name, _ABSENT)
    if isinstance(value, list):
        return f"({','.join(map(str, value))})"
    return f"{value:g}" if type(value) is float else str(value)


def as_json(runs: Sequence[Run]) -> list[dict[str, Any]]:
    """Return runs as plain values of JSON, with the settings that differ; None if a run does not have a setting."""
    names = differing(runs)
    return [
        {
            "name": run.name,
            "path": str(run.path),
            "state": run.state,
            "reason": run.reason,
            "step": run.step,
            "steps": run.steps,
            "best": run.best and run.best._asdict(),
            "changed": run.changed.isoformat(timespec="seconds"),
            "settings": {name: run.settings.get(name) for name in names},
        }
        for run in runs
    ]


def as_table(runs: Sequence[Run]) -> str:
    """Format runs as a table, with a column for each setting in which they differ, and remarks below it."""
    names = common_differing(runs)
    columns = names[:_MOST_COLUMNS]
    scores = sorted({run.best.name.removeprefix("loss/") for run in runs if run.best})
    title = f"best {scores[0]}" if len(scores) == 1 else "best"
    lines = [["run", *short_names(columns).values(), "step", title, "at step", "state", "last change"]]
    for run in runs:
        best = [_ABSENT, _ABSENT]
        if run.best:
            name = "" if len(scores) == 1 else f"{run.best.name.removeprefix('loss/')} "
            best = [f"{name}{run.best.value:.4g}", str(run.best.step)]
        values = [_value_text(run, name) for name in columns]
        values = [text if len(text) <= _MOST_LETTERS else f"{text[: _MOST_LETTERS - 3]}..." for text in values]
        steps = _ABSENT if run.steps is None else f"{run.step} / {run.steps}"
        lines.append([run.name, *values, steps, *best, run.state, f"{run.changed.astimezone():%Y-%m-%d %H:%M}"])
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    table = ["  ".join(map(str.ljust, line, widths)).rstrip() for line in lines]
    notes = [f"{run.name}: {run.state}, {run.reason}" for run in runs if run.reason]
    if names[_MOST_COLUMNS:]:
        notes.append(f"{len(names) - _MOST_COLUMNS} more settings differ: --json has all of them")
    return "\n".join([*table, *([""] if notes else []), *notes])
