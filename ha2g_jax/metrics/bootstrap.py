"""Percentile intervals of any score, by resampling the recordings that its samples come from."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np


class Interval(NamedTuple):
    """A score with the bounds of its interval (NaN bounds where fewer than two clusters leave them undefined)."""

    value: float
    low: float
    high: float


def bootstrap(
    statistic: Callable[[np.ndarray], float],
    clusters: np.ndarray,
    *,
    draws: int = 1000,
    seed: int = 0,
    level: float = 0.95,
) -> Interval:
    """A score of all samples and its percentile interval under resampling of whole clusters with replacement.

    Efron and Tibshirani 1993, chapter 13. Windows of one recording resemble each other, so that the recording, not the
    window, is what is drawn. For the difference of two methods let one statistic compute it on the same indices: the
    draws are then paired. The same arguments always give the same interval, and a draw in which the score is undefined
    (NaN) is left out.

    Args:
        statistic: a number from indices (m,) of samples; a sample that is drawn twice is listed twice.
        clusters: (n,) label of each sample's cluster (its source recording).
        draws: number of resamples.
        seed: seed of the draws; the same seed and clusters draw the same resamples for every statistic.
        level: share of the draws inside the interval.

    Returns:
        The interval; all NaN without samples, NaN bounds with one cluster or where no draw has a score.
    """
    _, members = np.unique(np.asarray(clusters), return_inverse=True)
    samples = np.arange(len(members))
    return bootstrap_counts(
        lambda counts: statistic(np.repeat(samples, counts[members])), clusters, draws=draws, seed=seed, level=level
    )


def bootstrap_counts(
    statistic: Callable[[np.ndarray], float],
    clusters: np.ndarray,
    *,
    draws: int = 1000,
    seed: int = 0,
    level: float = 0.95,
) -> Interval:
    """The same interval for a score that can be put together from parts, one per cluster (`frechet.pool` for one).

    Args:
        statistic: a number from counts (G,): how often each cluster is drawn, in the order of `np.unique(clusters)`.
        clusters: (n,) label of each sample's cluster.
        draws: number of resamples.
        seed: seed of the draws, the same as those of `bootstrap`.
        level: share of the draws inside the interval.
    """
    num_clusters = len(np.unique(np.asarray(clusters)))
    if not num_clusters:
        return Interval(np.nan, np.nan, np.nan)
    value = float(statistic(np.ones(num_clusters, np.int64)))
    if num_clusters < 2:
        return Interval(value, np.nan, np.nan)
    rng = np.random.default_rng(seed)
    scores = np.empty(draws)
    for draw in range(draws):
        drawn = rng.integers(num_clusters, size=num_clusters)
        scores[draw] = statistic(np.bincount(drawn, minlength=num_clusters))
    return Interval(value, *_percentiles(scores, level))


def bootstrap_mean(
    values: np.ndarray,
    clusters: np.ndarray,
    *,
    weights: np.ndarray | None = None,
    draws: int = 1000,
    seed: int = 0,
    level: float = 0.95,
) -> Interval:
    """The interval of a mean of values per clip, from sums per cluster: the same draws as `bootstrap`, much faster.

    Two methods on the same clips are compared by the mean of their differences.

    Args:
        values: (n,) value of each clip; a clip without one (NaN) is left out.
        clusters: (n,) label of each clip's cluster.
        weights: (n,) weight of each clip, such as its number of frames; 1 by default.
        draws: number of resamples.
        seed: seed of the draws.
        level: share of the draws inside the interval.
    """
    values = np.asarray(values, np.float64)
    weights = np.ones_like(values) if weights is None else np.asarray(weights, np.float64)
    has_value = ~np.isnan(values)
    weights = np.where(has_value, weights, 0.0)
    _, members = np.unique(np.asarray(clusters), return_inverse=True)
    sums = np.bincount(members, weights=weights * np.where(has_value, values, 0.0))
    totals = np.bincount(members, weights=weights)

    def mean(counts: np.ndarray) -> float:
        total = counts @ totals
        return float(counts @ sums / total) if total > 0 else np.nan

    return bootstrap_counts(mean, clusters, draws=draws, seed=seed, level=level)


def _percentiles(scores: np.ndarray, level: float) -> tuple[float, float]:
    scores = scores[~np.isnan(scores)]
    if not len(scores):
        return np.nan, np.nan
    tail = (1 - level) / 2
    with np.errstate(invalid="ignore"):  # between two infinite scores there is no number
        low, high = np.quantile(scores, [tail, 1 - tail])
    return float(low), float(high)
