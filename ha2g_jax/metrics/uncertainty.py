"""Uncertainty of scores: bootstrap intervals, jackknife standard errors, and p-values corrected for their number."""

import functools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np


class Interval(NamedTuple):
    """A score with the bounds of its interval (NaN bounds where fewer than two clusters leave them undefined)."""

    value: float
    low: float
    high: float


def bootstrap(
    statistic: Callable[[np.ndarray], float],
    num_clusters: int,
    *,
    draws: int = 1000,
    seed: int = 0,
    level: float = 0.95,
) -> Interval:
    """Return a score and the percentile interval under resampling of whole clusters with replacement.

    Efron and Tibshirani 1993, chapter 13. Windows of one recording resemble each other, so that recordings are drawn,
    not windows. The score is computed from one part per cluster, which makes a draw fast. For the difference between
    two methods, let one statistic compute it from the same counts: the draws are then paired. The same arguments always
    give the same interval, and a draw in which the score is undefined (NaN) is left out.

    Args:
        statistic: function from counts (G,), how often each cluster is drawn, to a number.
        num_clusters: number G of clusters, the recordings that samples come from.
        seed: seed of the draws; the same seed draws the same resamples for every statistic.

    Returns:
        The interval; all NaN without a cluster, NaN bounds with only one or if no draw has a score.
    """
    if not num_clusters:
        return Interval(np.nan, np.nan, np.nan)
    value = float(statistic(np.ones(num_clusters, np.int64)))
    if num_clusters < 2:
        return Interval(value, np.nan, np.nan)
    scores = np.array([statistic(counts) for counts in _resamples(num_clusters, draws, seed)])
    scores = scores[~np.isnan(scores)]
    if not len(scores):
        return Interval(value, np.nan, np.nan)
    tail = (1 - level) / 2
    with np.errstate(invalid="ignore"):  # between two infinite scores there is no number
        low, high = np.quantile(scores, [tail, 1 - tail]).tolist()
    return Interval(value, low, high)


@functools.lru_cache(maxsize=4)  # every metric of every row uses the same draws
def _resamples(num_clusters: int, draws: int, seed: int) -> np.ndarray:
    """Draw as many clusters as there are, with replacement, and count each, (draws, G)."""
    drawn = np.random.default_rng(seed).integers(num_clusters, size=(draws, num_clusters))
    places = drawn + num_clusters * np.arange(draws)[:, None]
    return np.bincount(places.ravel(), minlength=draws * num_clusters).reshape(draws, num_clusters)


class Estimate(NamedTuple):
    """A score with its standard error (NaN where fewer than two clusters leave it undefined)."""

    value: float
    error: float


def jackknife(samples: np.ndarray, statistic: Callable[[np.ndarray], float], clusters: np.ndarray) -> Estimate:
    """Return the statistic of all samples (n, ...) and the delete-one-cluster standard error.

    se^2 = (G - 1) / G sum_g (s_g - mean s)^2, with s_g the statistic without cluster g (Efron and Tibshirani 1993,
    chapter 11). No random numbers: the same samples give the same error. The statistic is a function of any non-empty
    subset of the rows; the clusters (n,) are labels, such as a clip or a speaker.
    """
    if not len(samples):
        return Estimate(np.nan, np.nan)
    labels = np.unique(clusters)
    value = float(statistic(samples))
    if len(labels) < 2:
        return Estimate(value, np.nan)
    parts = np.array([statistic(samples[clusters != label]) for label in labels])
    return Estimate(value, float(np.sqrt(jackknife_variance(parts))))


def jackknife_variance(without: np.ndarray) -> float:
    """Compute the variance of a score due to the clusters, from the scores (G,) without each; 0 if empty."""
    count = len(without)
    return float((count - 1) / count * np.sum(np.square(without - without.mean()))) if count else 0.0


def holm(p_values: Sequence[float]) -> list[float]:
    """Correct m p-values for multiple testing by Holm's step-down method (Holm 1979), in the same order.

    The k-th smallest of m is multiplied by m - k + 1, is at least as large as those before it, and at most 1.
    """
    order = np.argsort(p_values, kind="stable")
    factors = len(p_values) - np.arange(len(p_values))
    corrected = np.empty(len(p_values))
    corrected[order] = np.minimum(np.maximum.accumulate(np.asarray(p_values, float)[order] * factors), 1.0)
    return corrected.tolist()
