"""Scores with their intervals, in numbers of JSON."""

import math
from typing import Any

import numpy as np

from ha2g_jax.metrics.bootstrap import Interval, bootstrap_counts
from ha2g_jax.study.evaluation.latent_statistics import Statistic

DRAWS = 1000
LEVEL = 0.95

_DIGITS = 8  # that count


class Intervals:
    """Percentile intervals of statistics under resampling of sources; the same draws for every statistic."""

    def __init__(self, num_sources: int, draws: int, seed: int):
        self._sources, self._draws, self._seed = np.arange(num_sources), draws, seed

    def __call__(self, statistic: Statistic) -> dict[str, float | None]:
        """{"value", "low", "high"}, None where undefined."""
        return as_json(bootstrap_counts(statistic, self._sources, draws=self._draws, seed=self._seed, level=LEVEL))


def spread(values: np.ndarray) -> dict[str, float | None]:
    """The mean of random divisions, and what 95 % of them lie within."""
    if not len(values) or not np.isfinite(values).all():
        return as_json(Interval(math.nan, math.nan, math.nan))
    tail = (1 - LEVEL) / 2
    low, high = np.quantile(values, [tail, 1 - tail]).tolist()
    return as_json(Interval(float(np.mean(values)), low, high))


def as_json(values: Any) -> dict[str, float | None]:
    """A NamedTuple of numbers as a dict."""
    return {name: number(value) for name, value in values._asdict().items()}


def number(value: float) -> float | None:
    """A number of JSON, None where it is undefined."""
    return float(f"{value:.{_DIGITS}g}") if math.isfinite(value) else None
