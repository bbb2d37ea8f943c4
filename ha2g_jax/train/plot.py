"""Draw the curves of training runs in the same charts, with matplotlib: a page that works offline, or one picture."""

import html
import io
import logging
import os
import pathlib
from collections.abc import Sequence
from typing import Any

import numpy as np

from ha2g_jax.errors import UserError, require
from ha2g_jax.files.reading import shown
from ha2g_jax.files.writing import whole_file
from ha2g_jax.train.runs import Line, Run, as_table, find_workdirs, make_lines, read_runs
from ha2g_jax.train.workdir import METRICS, VALIDATION_PREFIX, read_metrics

_logger = logging.getLogger(__name__)

SMOOTHING = 0.04  # width of the running mean as a fraction of the steps

_PAGE_SUFFIX, _PICTURES = ".html", (".png", ".svg")
_CLOCKS = ("step", "seconds", "compile_seconds")  # metrics that are not drawn
_WIDTH, _HEIGHT = 5.2, 2.7  # inches of a chart, of which two are side by side
_LOG_FROM = 20.0  # ratio of the greatest to the least value from which an axis is logarithmic
_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>{title}</title>
<style>body {{ font: 15px sans-serif; margin: 2em auto; max-width: 65em }} pre {{ overflow-x: auto }}
svg {{ width: 100%; height: auto }}</style></head>
<body><h1>{title}</h1><pre>{table}</pre>
<p>{note}</p>
{picture}
</body></html>
"""


def write_plot(
    folders: Sequence[str | os.PathLike], out: str | os.PathLike, *, smoothing: float = SMOOTHING
) -> pathlib.Path:
    """Write the curves of all metrics of the runs in some folders atomically, and return the path.

    Equal workdirs give equal files.

    Args:
        out: path to write: .html for a page with the table of the runs, or .png or .svg for the curves alone.
        smoothing: width of the running mean of training metrics, as a fraction of the steps of the longest run; 0 for
            none. Validation scores are not smoothed.

    Raises:
        UserError: a folder has no run, no run can be read, an argument is out of range, matplotlib is missing, or the
            file cannot be written.
    """
    out = pathlib.Path(out)
    suffix = out.suffix.lower()
    if suffix not in (_PAGE_SUFFIX, *_PICTURES):
        raise UserError(f"{shown(out.name)} is neither a page nor a picture; name it {shown(out.stem)}.html or .png")
    if not 0 <= smoothing <= 1:
        raise UserError(f"the smoothing is {smoothing:g}; give a fraction of the steps from 0 to 1, such as 0.02")
    mpl = require("matplotlib", "report", by="a page of curves")
    runs = read_runs(path for folder in folders for path in find_workdirs(folder))
    if not any(run.settings for run in runs):
        more = f" and {len(runs) - 1} more runs" if runs[1:] else ""
        why = runs[0].reason or "it has not begun"
        raise UserError(f"{shown(runs[0].path)}{more} cannot be read ({why}); name other runs")
    width = smoothing * max(run.step for run in runs)
    # Fixed ids and no date, so that equal runs give equal files.
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": "ha2g", "font.size": 9, "text.parse_math": False}):
        figure = _draw(make_lines(runs), width)
        with whole_file(out) as temporary:
            if suffix in _PICTURES:
                figure.savefig(temporary, metadata={"Date": None} if suffix == ".svg" else None)
            else:
                temporary.write_text(_page(runs, figure, width), encoding="utf-8")
    return out


def _page(runs: Sequence[Run], figure: Any, width: float) -> str:
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None})
    picture = buffer.getvalue()
    smooth = f"Training curves are running means over {width:,.0f} steps" if width >= 1 else "Curves are not smoothed"
    return _PAGE.format(
        title=html.escape(f"Training of {runs[0].name}" if len(runs) == 1 else f"Training of {len(runs)} runs"),
        table=html.escape(as_table(runs)),
        note=f"{smooth}; validation scores are as measured. Runs whose configs differ only in the seed are one line: "
        "the mean of the seeds, with a band from the least to the greatest of them, or thin "
        "lines where not all have values.",
        picture=picture[picture.index("<svg") :],
    )


def _draw(lines: Sequence[Line], width: float) -> Any:
    """Return the figure: a chart of each loss term, its validation beside or below it, then of the other metrics."""
    from matplotlib.figure import Figure

    metrics = {run.path: _metrics(run) for line in lines for run in line.runs}
    terms = dict.fromkeys(name.removeprefix(VALIDATION_PREFIX) for by_name in metrics.values() for name in by_name)
    names = [
        name
        for term in sorted(terms, key=lambda term: not term.startswith("loss/"))
        for name in (term, VALIDATION_PREFIX + term)
        if any(name in by_name for by_name in metrics.values())
    ]
    num_rows = -(-len(names) // 2)
    figure = Figure(figsize=(2 * _WIDTH, _HEIGHT * max(num_rows, 1)), layout="constrained")
    if not names:
        figure.suptitle("No run has written metrics yet.")
    handles = {}
    for place, name in enumerate(names, 1):
        axes = figure.add_subplot(num_rows, 2, place)
        for number, line in enumerate(lines):
            series = [metrics[run.path][name] for run in line.runs if name in metrics[run.path]]
            if not name.startswith(VALIDATION_PREFIX):
                series = [(steps, running_mean(steps, values, width)) for steps, values in series]
            if series:
                style: Any = {"color": f"C{number % 10}", "gid": f"line-{number}"}
                steps, means = align_seeds(series)
                mean = np.mean(means, axis=0)  # NaN where not all seeds are
                (handles[line.label],) = axes.plot(steps, mean, ".-" if len(steps) == 1 else "-", **style)
                if len(series) > 1:
                    axes.fill_between(steps, means.min(axis=0), means.max(axis=0), alpha=0.2, linewidth=0, **style)
                    rest = np.isnan(mean)
                    rest |= np.append(rest[1:], False) | np.append(False, rest[:-1])  # joined to the mean's ends
                    mark = "." if min(len(at) for at, _ in series) == 1 else ""
                    alone = np.where(rest, means, np.nan).T
                    axes.plot(steps, alone, color=style["color"], linewidth=0.5, marker=mark)
        low, high = axes.dataLim.intervaly
        if low > 0 and high > _LOG_FROM * low:
            axes.set_yscale("log")
        axes.set_title(name, loc="left")
        axes.set_xlabel("step")
        axes.grid(alpha=0.3)
    figure.legend(handles.values(), handles.keys(), loc="outside upper left", ncols=3)
    return figure


def _metrics(run: Run) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return the steps and the values of the metrics of a run, without clocks and values that are not finite; none of a
    run whose metrics are damaged, with a warning.
    """
    points: dict[str, list[tuple[float, float]]] = {}
    try:
        rows = read_metrics(run.path / METRICS) if (run.path / METRICS).is_file() else []
    except UserError as error:
        _logger.warning("%s; its curves are left out", error)
        return {}
    for row in rows:
        for name, value in row.items():
            if name not in _CLOCKS and np.isfinite(value):
                points.setdefault(name, []).append((row["step"], value))
    return {name: tuple(np.array(pairs, float).T) for name, pairs in points.items()}


def running_mean(steps: np.ndarray, values: np.ndarray, width: float) -> np.ndarray:
    """Compute the means (n,) of values (n,) in a window of `width` steps around each of their steps (n,), ascending."""
    first = np.searchsorted(steps, steps - width / 2, side="left")
    last = np.searchsorted(steps, steps + width / 2, side="right")
    return np.array([values[start:end].mean() for start, end in zip(first, last, strict=True)])


def align_seeds(series: Sequence[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    """Return all steps (m,) of some runs, and values (runs, m), interpolated linearly, NaN outside a run's steps."""
    at = np.unique(np.concatenate([steps for steps, _ in series]))
    return at, np.stack([np.interp(at, steps, values, left=np.nan, right=np.nan) for steps, values in series])
