"""Draw the curves of training runs over one another, with matplotlib: a page that works offline, or one picture."""

import html
import io
import os
import pathlib
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ha2g_jax.errors import UserError, require
from ha2g_jax.files.reading import shown
from ha2g_jax.files.writing import whole_file
from ha2g_jax.train.runs import DAMAGED, VALIDATION, Line, Run, as_table, find_workdirs, make_lines, read_runs
from ha2g_jax.train.workdir import METRICS, read_metrics

SMOOTHING = 0.04  # width of the running mean as a fraction of the steps

_PAGE_SUFFIX, _PICTURES = ".html", (".png", ".svg")
_CLOCKS = ("step", "seconds", "compile_seconds")  # no curves
_LOSS, _TOTAL = "loss/", "loss/total"
_AFTER_LOSSES = ("grad_norm/", "gradient_ratio/", "learning_rate/")  # the other metrics, such as the speed, are last
_WIDTH, _HEIGHT = 5.2, 2.7  # inches of a chart, of which two are side by side
_MOST_POINTS = 240  # points of a curve
_FLAT = 1e-6  # range of an axis, relative to its values, up to which they are equal but for rounding
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

# Workdir of a run -> name of a metric -> its steps and its finite values.
Metrics = Mapping[pathlib.Path, Mapping[str, tuple[np.ndarray, np.ndarray]]]


class Curve(NamedTuple):
    """A metric of one line of runs."""

    line: int
    steps: np.ndarray  # (m,)
    means: np.ndarray  # (runs, m) running mean of each run, NaN where there is no value


def write_plot(
    folders: Sequence[str | os.PathLike], out: str | os.PathLike, *, smoothing: float = SMOOTHING
) -> pathlib.Path:
    """Write the curves of all metrics of the runs in some folders, completely or not at all, and return the path.

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
    if all(run.state == DAMAGED for run in runs):
        more = f" and {len(runs) - 1} more runs" if runs[1:] else ""
        raise UserError(f"{shown(runs[0].path)}{more} cannot be read ({runs[0].reason}); name other runs")
    lines = make_lines(runs)
    width = smoothing * max(run.step for run in runs)
    metrics = {run.path: _metrics(run) for line in lines for run in line.runs}
    # Fixed ids and no date, so that equal runs give equal files.
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": "ha2g", "font.size": 9}):
        figure = _draw(lines, metrics, width)
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
        "the mean of the seeds, with a band from the least to the greatest of them.",
        picture=picture[picture.index("<svg") :],
    )


def _metrics(run: Run) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return the metrics of a run by name, without clocks and without values that are not finite."""
    if not (run.path / METRICS).is_file():
        return {}
    points: dict[str, list[tuple[float, float]]] = {}
    for row in read_metrics(run.path / METRICS):
        for name, value in row.items():
            if name not in _CLOCKS and np.isfinite(value):
                points.setdefault(name, []).append((row["step"], value))
    if windows := points.get("windows_per_second"):
        size = run.settings["train.batch_size"]
        points["steps_per_second"] = [(step, value / size) for step, value in windows]
    return {name: tuple(np.array(pairs, float).T) for name, pairs in points.items()}


def make_curves(name: str, lines: Sequence[Line], metrics: Metrics, width: float) -> list[Curve]:
    """Compute the curves of a metric, running means over `width` steps; lines without the metric have none."""
    found = {
        number: [metrics[run.path][name] for run in line.runs if name in metrics[run.path]]
        for number, line in enumerate(lines)
    }
    steps = [steps for series in found.values() for steps, _ in series]
    if not steps:
        return []
    at = np.unique(np.concatenate(steps))
    if len(at) > _MOST_POINTS:
        at = np.linspace(at[0], at[-1], _MOST_POINTS)
        width = max(width, at[1] - at[0])  # every value counts, also where curves are only thinned
    curves = []
    for number, series in found.items():
        if series:
            means = np.stack([running_mean(steps, values, at, width) for steps, values in series])
            has_values = np.isfinite(means).any(axis=0)
            curves.append(Curve(number, at[has_values], means[:, has_values]))
    return curves


def running_mean(steps: np.ndarray, values: np.ndarray, at: np.ndarray, width: float) -> np.ndarray:
    """Compute the means (m,) of values (n,) in a window of `width` steps around each of some steps (m,).

    Where a window has no value, the means of its neighbours are joined by a line; with a width of 0 the values
    themselves are. Before the first and after the last of the `steps` (n,), which ascend, the result is NaN.
    """
    first = np.searchsorted(steps, at - width / 2, side="left")
    last = np.searchsorted(steps, at + width / 2, side="right")
    sums = np.concatenate([[0.0], np.cumsum(values)])
    has_values = last > first
    if has_values.any():
        means = (sums[last] - sums[first])[has_values] / (last - first)[has_values]
        means = np.interp(at, at[has_values], means)
    else:
        means = np.interp(at, steps, values)
    return np.where((at < steps[0]) | (at > steps[-1]), np.nan, means)


def _draw(lines: Sequence[Line], metrics: Metrics, width: float) -> Any:
    """Return the figure: each loss term with its validation beside it, then the other metrics."""
    from matplotlib.figure import Figure

    names = list(dict.fromkeys(name for by_name in metrics.values() for name in by_name))
    terms = dict.fromkeys(name.removeprefix(VALIDATION) for name in names)
    best_by = {line.runs[0].settings["train.best_by"] for line in lines}
    losses = [name for name in terms if name.startswith(_LOSS)]
    losses.sort(key=lambda name: (name not in best_by, name != _TOTAL))
    others = [name for name in names if name.removeprefix(VALIDATION) not in losses]
    others.sort(key=lambda name: [not name.startswith(start) for start in _AFTER_LOSSES])
    num_rows = len(losses) + -(-len(others) // 2)
    figure = Figure(figsize=(2 * _WIDTH, _HEIGHT * max(num_rows, 1)), layout="constrained")
    if not num_rows:
        figure.suptitle("No run has written metrics yet.")
        return figure
    first = None  # whose horizontal axis is that of all charts
    for row, name in enumerate(losses):
        training = make_curves(name, lines, metrics, width)
        validation = make_curves(VALIDATION + name, lines, metrics, 0.0)
        left = None
        for column, (title, curves) in enumerate({name: training, VALIDATION + name: validation}.items(), 1):
            if curves:
                left = figure.add_subplot(num_rows, 2, 2 * row + column, sharey=left, sharex=first)
                first = first or left
                _draw_chart(left, title, lines, curves)
                _choose_scale(left, [*training, *validation])
    for place, name in enumerate(others, 2 * len(losses) + 1):
        curves = make_curves(name, lines, metrics, 0.0 if name.startswith(VALIDATION) else width)
        axes = figure.add_subplot(num_rows, 2, place, sharex=first)
        first = first or axes
        _draw_chart(axes, name, lines, curves)
        _choose_scale(axes, curves)
    handles = {label: handle for axes in figure.axes for handle, label in zip(*axes.get_legend_handles_labels())}
    figure.legend(handles.values(), handles.keys(), loc="outside upper left", ncols=3)
    return figure


def _draw_chart(axes: Any, name: str, lines: Sequence[Line], curves: Sequence[Curve]) -> None:
    """Draw a line for each curve, and the range of its runs as a band."""
    for curve in curves:
        style = {"color": f"C{curve.line % 10}", "gid": f"line-{curve.line}"}
        mean, least, greatest = (each(curve.means, axis=0) for each in (np.nanmean, np.nanmin, np.nanmax))
        mark = {"marker": "."} if len(curve.steps) == 1 else {}
        dashes = ("solid", "dashed", "dotted")[curve.line // 10 % 3]
        axes.plot(curve.steps, mean, linestyle=dashes, label=lines[curve.line].label, **mark, **style)
        if len(curve.means) > 1:
            axes.fill_between(curve.steps, least, greatest, alpha=0.2, linewidth=0, **style)
    axes.set_title(name, loc="left")
    axes.set_xlabel("step")
    axes.grid(alpha=0.3)


def _choose_scale(axes: Any, curves: Sequence[Curve]) -> None:
    values = np.concatenate([curve.means.ravel() for curve in curves])
    low, high = np.nanmin(values), np.nanmax(values)
    if low > 0 and high > _LOG_FROM * low:
        axes.set_yscale("log")
    elif high - low <= _FLAT * max(abs(low), abs(high)):  # constant, so that only its rounding would be seen
        margin = abs(high) / 2 or 1.0
        axes.set_ylim(low - margin, high + margin)
