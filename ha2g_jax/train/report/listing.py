"""The runs below a folder as a table of the terminal or as JSON."""

import datetime
import math
import os
from collections.abc import Callable, Sequence
from typing import Any

from ha2g_jax.train.report.lines import ABSENT, common_differing, differing, short_names, value_text
from ha2g_jax.train.report.runs import STATES, Run, find_workdirs, read_runs

_MOST_SETTINGS = 8  # columns of settings; the others are in the JSON
_LONGEST = 24  # letters of a value of a setting

# Order of the rows: name, then the key by which they are sorted; what is sought for comes first.
SORTS: dict[str, Callable[[Run], Any]] = {
    "name": lambda run: 0,
    "step": lambda run: -run.step,
    "best": lambda run: math.inf if run.best is None else run.best.value,
    "state": lambda run: STATES.index(run.state),
    "changed": lambda run: -run.changed.timestamp(),
}


def list_runs(folder: str | os.PathLike, sort: str = "name") -> list[Run]:
    """Return all runs below a folder.

    Args:
        folder: folder of runs, at any depth, or one workdir.
        sort: one of `SORTS`: by name, most steps first, least validation score first, by state, or last changed first.

    Raises:
        UserError: there is no such folder, or no run below it.
    """
    return sorted(sorted(read_runs(find_workdirs(folder)), key=lambda run: run.name), key=SORTS[sort])


def as_json(runs: Sequence[Run]) -> list[dict[str, Any]]:
    """Return runs as plain values of JSON.

    Args:
        runs: runs from `list_runs`.

    Returns:
        For each run its name, path, state and reason, step and steps, the best score, the time of the last change in
        UTC, and the settings in which the runs differ, None where a run does not have one.
    """
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
    """Format runs as a table, with a column for each setting in which they differ, and remarks below it.

    Args:
        runs: runs from `list_runs`.
    """
    names = common_differing(runs)
    shown = names[:_MOST_SETTINGS]
    scores = sorted({run.best.name for run in runs if run.best})
    title = f"best {_last(scores[0])}" if len(scores) == 1 else "best"
    lines = [["run", *short_names(shown).values(), "step", title, "at step", "state", "last change"]]
    for run in runs:
        best = ["-", "-"]
        if run.best:
            number = f"{run.best.value:.4g}"
            best = [number if len(scores) == 1 else f"{_last(run.best.name)} {number}", str(run.best.step)]
        settings = [_cut(value_text(run.settings, name)) if run.settings else ABSENT for name in shown]
        steps = "-" if run.steps is None else f"{run.step} / {run.steps}"
        lines.append([run.name, *settings, steps, *best, run.state, _local(run.changed)])
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    table = ["  ".join(map(str.ljust, line, widths)).rstrip() for line in lines]
    notes = [f"{run.name}: {run.state}, {run.reason}" for run in runs if run.reason]
    if names[_MOST_SETTINGS:]:
        notes.append(f"{len(names) - _MOST_SETTINGS} more settings differ: --json has all of them")
    return "\n".join([*table, *([""] if notes else []), *notes])


def _last(name: str) -> str:
    return name.removeprefix("loss/")


def _cut(text: str) -> str:
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."


def _local(time: datetime.datetime) -> str:
    return f"{time.astimezone():%Y-%m-%d %H:%M}"
