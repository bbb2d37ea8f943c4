"""Logged metrics as arrays, and what a chart shows of them: running means at few steps, and extremes."""

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

_APART = ("step", "seconds", "compile_seconds")  # the step itself, and clocks, which are no curves


class Series(NamedTuple):
    """Values of one metric of a run.

    Attributes:
        steps: (n,) steps in ascending order, each once.
        values: (n,) finite values.
        num_left_out: number of values that are not finite, which are left out.
    """

    steps: np.ndarray
    values: np.ndarray
    num_left_out: int = 0


def to_series(rows: Iterable[Mapping[str, float]]) -> dict[str, Series]:
    """Return the metrics of a run by name, without clocks.

    Where the steps go back, as after a kill, the rows that were written last hold: earlier rows of the same or of later
    steps are dropped.

    Args:
        rows: rows of `metrics.jsonl` in their order; each has a step, and not each has all metrics.
    """
    steps: dict[str, list[float]] = {}
    values: dict[str, list[float]] = {}
    for row in _last_written(list(rows)):
        step = row["step"]
        for name, value in row.items():
            if name not in values:
                steps[name], values[name] = [], []
            steps[name].append(step)
            values[name].append(value)
    return {name: _clean(np.array(steps[name]), np.array(values[name], float)) for name in values if name not in _APART}


def _last_written(rows: Sequence[Mapping[str, float]]) -> list[Mapping[str, float]]:
    """Return the rows without those of a step that a later row goes back behind; a step may have several rows."""
    kept: list[Mapping[str, float]] = []
    least = np.inf
    for row in reversed(rows):
        if row["step"] <= least:
            kept.append(row)
            least = row["step"]
    return kept[::-1]


def _clean(steps: np.ndarray, values: np.ndarray) -> Series:
    holds = np.append(steps[:-1] < steps[1:], True)  # of several rows with a metric at one step, the last
    is_finite = np.isfinite(values)
    kept = holds & is_finite
    return Series(steps[kept], values[kept], int((holds & ~is_finite).sum()))


def shown_steps(series: Sequence[Series], most: int) -> np.ndarray:
    """Return the steps at which a chart shows series: all logged ones, or so many at equal distances.

    Args:
        series: series of one chart.
        most: largest number of steps.
    """
    steps = np.unique(np.concatenate([one.steps for one in series])).astype(float)
    return steps if len(steps) <= most else np.linspace(steps[0], steps[-1], most)


def running_mean(series: Series, at: np.ndarray, width: float) -> np.ndarray:
    """Compute the mean of the values around each of some steps.

    Where a window has no value, the means of its neighbours are joined by a line.

    Args:
        series: series with at least one value.
        at: (m,) steps in ascending order.
        width: number of steps of the window around each of them; 0 for the values themselves, joined by lines.

    Returns:
        (m,) means, NaN before the first and after the last step of the series.
    """
    first = np.searchsorted(series.steps, at - width / 2, side="left")
    last = np.searchsorted(series.steps, at + width / 2, side="right")
    sums = np.concatenate([[0.0], np.cumsum(series.values)])
    count = last - first
    has_values = count > 0
    means = np.full(len(at), np.nan)
    means[has_values] = (sums[last] - sums[first])[has_values] / count[has_values]
    if has_values.any():
        means = np.interp(at, at[has_values], means[has_values])
    else:
        means = np.interp(at, series.steps, series.values)
    means[(at < series.steps[0]) | (at > series.steps[-1])] = np.nan
    return means


def extremes(series: Series, most: int) -> Series:
    """Return the least and the greatest value of each of some equal parts of a series, which keeps its outliers.

    Args:
        series: series to thin.
        most: largest number of values to return; a shorter series is returned as it is.
    """
    if len(series.steps) <= most:
        return series
    parts = np.array_split(np.arange(len(series.steps)), most // 2)
    kept = np.unique(
        [place for part in parts for place in (part[series.values[part].argmin()], part[series.values[part].argmax()])]
    )
    return Series(series.steps[kept], series.values[kept], series.num_left_out)
