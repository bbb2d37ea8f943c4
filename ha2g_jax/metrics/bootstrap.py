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
    """Return a score and the percentile interval under resampling of whole clusters with replacement.

    Efron and Tibshirani 1993, chapter 13. Windows of one recording resemble each other, so that the recording, not the
    window, is drawn. The score is put together from one part per cluster, which makes a draw fast. For the difference
    of two methods let one statistic compute it on the same counts: the draws are then paired. The same arguments always
    give the same interval, and a draw in which the score is undefined (NaN) is left out.

    Args:
        statistic: function of counts (G,), how often each cluster is drawn in the order of `np.unique(clusters)`, to a
            number.
        clusters: (n,) label of each sample's cluster (the recording that it comes from).
        draws: number of resamples.
        seed: seed of the draws; the same seed and clusters draw the same resamples for every statistic.
        level: ratio of the draws that lie inside the interval.

    Returns:
        The interval; all NaN without samples, NaN bounds with one cluster or where no draw has a score.
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


def _percentiles(scores: np.ndarray, level: float) -> tuple[float, float]:
    scores = scores[~np.isnan(scores)]
    if not len(scores):
        return np.nan, np.nan
    tail = (1 - level) / 2
    with np.errstate(invalid="ignore"):  # between two infinite scores there is no number
        low, high = np.quantile(scores, [tail, 1 - tail])
    return float(low), float(high)
