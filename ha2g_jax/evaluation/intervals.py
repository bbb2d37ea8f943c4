"""Scores with their intervals, in numbers of JSON."""

import math
from typing import Any

import numpy as np

from ha2g_jax.metrics.metric import Score, Statistic
from ha2g_jax.metrics.uncertainty import Estimate, Interval, bootstrap

DRAWS = 1000
LEVEL = 0.95

_DIGITS = 8  # that count
_DIGITS_OF_ERRORS = 4  # after the point
_Z = 1.96  # standard errors on both sides of a value that hold 95 %


class Intervals:
    """Percentile intervals of statistics under resampling of recordings, with the same draws for every statistic."""

    def __init__(self, num_recordings: int, draws: int, seed: int):
        self._recordings, self._draws, self._seed = np.arange(num_recordings), draws, seed

    def __call__(self, score: Score) -> dict[str, float | None]:
        """Return {"value", "low", "high"} of a score, None where undefined; a number has no bounds."""
        return self.of_statistic(score) if callable(score) else score_as_json(score)

    def of_statistic(self, statistic: Statistic) -> dict[str, float | None]:
        """Return {"value", "low", "high"} of a statistic, None where undefined."""
        return as_json(bootstrap(statistic, self._recordings, draws=self._draws, seed=self._seed, level=LEVEL))


def spread(values: np.ndarray) -> dict[str, float | None]:
    """Return the mean of random divisions, and the bounds of the middle 95 % of them."""
    if not len(values) or not np.isfinite(values).all():
        return as_json(Interval(math.nan, math.nan, math.nan))
    tail = (1 - LEVEL) / 2
    low, high = np.quantile(values, [tail, 1 - tail]).tolist()
    return as_json(Interval(float(np.mean(values)), low, high))


def as_json(values: Any) -> dict[str, float | None]:
    """Return a NamedTuple of numbers as a dict."""
    return {name: number(value) for name, value in values._asdict().items()}


def number(value: float) -> float | None:
    """Return a number of JSON, None where it is undefined."""
    return float(f"{value:.{_DIGITS}g}") if math.isfinite(value) else None


def score_as_json(score: Score) -> dict[str, float | None]:
    """Return {"value", "low", "high"} of a score that needs no bootstrap, with "error" where it has a standard error.

    The bounds are 1.96 standard errors below and above the value; a number has none.
    """
    if callable(score):
        raise TypeError("a statistic needs the recordings of a table; use `Intervals`")
    if not isinstance(score, Estimate):
        return as_json(Interval(math.nan if score is None else score, math.nan, math.nan))
    value, error = score
    bounds = (value, value - _Z * error, value + _Z * error, error)
    return {
        name: round(float(x), _DIGITS_OF_ERRORS) if math.isfinite(x) else None
        for name, x in zip(("value", "low", "high", "error"), bounds, strict=True)
    }
