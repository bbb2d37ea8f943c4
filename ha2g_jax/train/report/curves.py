"""What a chart shows of a metric: for each line its mean over seeds by step, their range, and the logged values."""

import pathlib
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ha2g_jax.train.report.lines import Line
from ha2g_jax.train.report.series import Series, extremes, running_mean, shown_steps

_MOST_POINTS = 240  # points of a curve, whose chart is about 480 pixels wide
_LEAST_POINTS, _POINTS_OF_ALL = 60, 4000  # of many lines each has fewer points, so that the page stays small
_MOST_LOGGED = 8  # lines of a page up to which the logged values are drawn as well
_LOG_FROM = 20.0  # ratio of the greatest to the least value from which an axis is logarithmic

# Workdir of a run -> metrics by name.
Metrics = Mapping[pathlib.Path, Mapping[str, Series]]


class Curve(NamedTuple):
    """One line of a chart; NaN where it has no value.

    Attributes:
        number: number of the line, from 0, which its colour and its dashes depend on.
        label: label of the line.
        steps: (m,) steps.
        mean: (m,) running mean of the run, or the mean of those of its seeds.
        low: (m,) least of the seeds; None for a line of one run.
        high: (m,) greatest of the seeds; None for a line of one run.
        is_whole: (m,) whether all runs of the line that have this metric have a value.
        logged: values as logged, of a line of one run, unless there are many lines.
        num_runs: number of runs with this metric.
        num_left_out: number of logged values that are not finite.
    """

    number: int
    label: str
    steps: np.ndarray
    mean: np.ndarray
    low: np.ndarray | None
    high: np.ndarray | None
    is_whole: np.ndarray
    logged: Series | None
    num_runs: int
    num_left_out: int


class Last(NamedTuple):
    """Values of a line at the end of its curve.

    Attributes:
        step: last step that all runs of the line with this metric have reached.
        value: mean over the runs at this step.
        low: least of the runs.
        high: greatest of the runs.
        best: least value of the mean, with its step.
        best_step: step of `best`.
    """

    step: int
    value: float
    low: float
    high: float
    best: float
    best_step: int


def make_curves(name: str, lines: Sequence[Line], metrics: Metrics, width: float) -> list[Curve]:
    """Compute the curves of a metric; lines without it have none.

    Args:
        name: name of the metric.
        lines: all lines of the page.
        metrics: metrics of all runs.
        width: number of steps of the running mean; 0 for none.
    """
    found: dict[int, list[Series]] = {}
    left_out: dict[int, int] = {}
    for number, line in enumerate(lines):
        series = [metrics[run.path][name] for run in line.runs if name in metrics[run.path]]
        left_out[number] = sum(one.num_left_out for one in series)
        if series := [one for one in series if len(one.steps)]:
            found[number] = series
    if not found:
        return []
    most = min(_MOST_POINTS, max(_LEAST_POINTS, _POINTS_OF_ALL // len(lines)))
    at = shown_steps([one for series in found.values() for one in series], most)
    if len(at) == most:
        width = max(width, at[1] - at[0])  # every value counts, also where curves are only thinned
    curves = []
    for number, series in found.items():
        means = np.stack([running_mean(one, at, width) for one in series])
        count = np.isfinite(means).sum(axis=0)
        with_values = count > 0
        steps, means, count = at[with_values], means[:, with_values], count[with_values]
        is_spread = len(series) > 1
        curves.append(
            Curve(
                number=number,
                label=lines[number].label,
                steps=steps,
                mean=np.nanmean(means, axis=0),
                low=np.nanmin(means, axis=0) if is_spread else None,
                high=np.nanmax(means, axis=0) if is_spread else None,
                is_whole=count == len(series),
                logged=None if is_spread or len(lines) > _MOST_LOGGED else extremes(series[0], 2 * _MOST_POINTS),
                num_runs=len(series),
                num_left_out=left_out[number],
            )
        )
    return curves


def last_values(curve: Curve) -> Last:
    """Return the values of a line at the last step that all of its runs have reached, and its least value.

    Args:
        curve: curve from `make_curves`.
    """
    places = np.flatnonzero(curve.is_whole)
    if not len(places):  # runs that logged no step in common, as one that was started again and one that ended early
        places = np.arange(len(curve.steps))
    last, best = places[-1], places[curve.mean[places].argmin()]
    low, high = (curve.mean if bound is None else bound for bound in (curve.low, curve.high))
    return Last(
        step=round(float(curve.steps[last])),
        value=float(curve.mean[last]),
        low=float(low[last]),
        high=float(high[last]),
        best=float(curve.mean[best]),
        best_step=round(float(curve.steps[best])),
    )


def value_range(curves: Sequence[Curve]) -> tuple[float, float]:
    """Return the least and the greatest value of curves and of their ranges, without the single logged values.

    Args:
        curves: at least one curve.
    """
    values = [bound for curve in curves for bound in (curve.mean, curve.low, curve.high) if bound is not None]
    return float(min(each.min() for each in values)), float(max(each.max() for each in values))


def is_logarithmic(low: float, high: float) -> bool:
    """Return whether an axis from `low` to `high` is logarithmic."""
    return low > 0 and high / low > _LOG_FROM
