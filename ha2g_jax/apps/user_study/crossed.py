"""Intervals of statistics whose answers are crossed: each is by one participant, about one clip, and both are samples.

The variance of a statistic is that over participants plus that over clips, each by the delete-one jackknife (Efron and
Tibshirani 1993, chapter 11). In a complete design these are the two mean squares of the tests F1 and F2, and their sum
is the denominator of min F' (Clark 1973). The part of the variance that is due to single answers is in both, so that
the interval is rather too wide than too narrow.
"""

from typing import NamedTuple

import numpy as np
from scipy import stats

LEVEL = 0.95
"""Confidence level of every interval of a report."""


class Estimate(NamedTuple):
    """A statistic, or an array of them.

    Attributes:
        value: the statistic.
        low: lower bound; NaN where it is undefined.
        high: upper bound; NaN where it is undefined.
        error: standard error.
        freedom: degrees of freedom of the t distribution.
        p: two-sided p-value of the hypothesis that the statistic is 0.
    """

    value: np.ndarray
    low: np.ndarray
    high: np.ndarray
    error: np.ndarray
    freedom: np.ndarray
    p: np.ndarray


# A variance below the square of this, relative to the statistic, is that of rounding.
_ROUNDING = 1e-6


class Spread(NamedTuple):
    """Variance of a statistic over participants or over clips, and the number of these."""

    variance: np.ndarray
    size: np.ndarray


def jackknife(parts: np.ndarray, is_used: np.ndarray | None = None) -> Spread:
    """Return the delete-one variance, (G - 1) / G sum_g (s_g - mean s)^2.

    Args:
        parts: (..., G) statistic without each of the G participants or clips.
        is_used: (..., G) whether there are answers of a participant or clip; by default of all.

    Returns:
        The variance (...), NaN where fewer than two are used or the statistic without one of them is undefined.
    """
    is_used = np.ones(parts.shape, bool) if is_used is None else is_used
    count = is_used.sum(-1)
    used = np.where(is_used, parts, 0.0)
    mean = used.sum(-1) / np.maximum(count, 1)
    squares = np.where(is_used, np.square(used - mean[..., None]), 0.0).sum(-1)
    squares = np.where(squares <= np.square(_ROUNDING * np.maximum(1.0, np.abs(mean))), 0.0, squares)
    return Spread(np.where(count > 1, (count - 1) / np.maximum(count, 1) * squares, np.nan), count)


def crossed(
    value: np.ndarray, participants: Spread, clips: Spread, *, least: np.ndarray | float = 0.0, level: float = LEVEL
) -> Estimate:
    """Return the t interval of a statistic over participants and clips.

    The variance is v_p + v_c, with (v_p + v_c)^2 / (v_p^2 / (P - 1) + v_c^2 / (C - 1)) degrees of freedom, as of min F'
    (Clark 1973). With one clip the interval is about participants alone; with one participant there is none, nor
    where all answers agree, as nothing is then known of how much others would differ.

    Args:
        value: (...) statistic of all answers.
        participants: variance over participants.
        clips: variance over clips.
        least: variance that the sum is at least.
        level: confidence level.
    """
    of_clips = np.where(clips.size > 1, clips.variance, 0.0)
    variance = participants.variance + of_clips
    freedom = degrees_of_freedom(participants, clips)
    variance = np.maximum(variance, least)
    error = np.sqrt(np.where(variance > 0, variance, np.nan))
    with np.errstate(invalid="ignore", divide="ignore"):
        half = stats.t.ppf(0.5 + level / 2, freedom) * error
        ratio = np.abs(value) / error
        p = np.where(value == 0, 1.0, 2 * stats.t.sf(ratio, freedom))
    p = np.where(np.isnan(error), np.nan, p)
    return Estimate(np.asarray(value), value - half, value + half, error, freedom, p)


def degrees_of_freedom(participants: Spread, clips: Spread) -> np.ndarray:
    """Return the degrees of freedom of the sum of two variances; see `crossed`."""
    of_clips = np.where(clips.size > 1, clips.variance, 0.0)
    squares = np.square(participants.variance) / np.maximum(participants.size - 1, 1)
    squares = squares + np.square(of_clips) / np.maximum(clips.size - 1, 1)
    total = np.square(participants.variance + of_clips)
    return np.where(squares > 0, total / np.where(squares > 0, squares, 1.0), np.maximum(participants.size - 1, 1))


def ratio(sums: np.ndarray, counts: np.ndarray) -> Spread:
    """Return the delete-one variance of sum / count, such as a mean of all answers or a share of them.

    Args:
        sums: (..., G) sum over the answers of each participant or clip.
        counts: (..., G) number of these answers.
    """
    left = counts.sum(-1, keepdims=True) - counts
    is_used = counts > 0
    parts = np.where(is_used & (left > 0), (sums.sum(-1, keepdims=True) - sums) / np.maximum(left, 1), np.nan)
    return jackknife(np.where(is_used, parts, 0.0), is_used)


def mean(values: np.ndarray, participants: np.ndarray, clips: np.ndarray) -> Estimate:
    """Return the mean of values with its interval.

    Args:
        values: (n,) values, at least one.
        participants: (n,) index of the participant of each value.
        clips: (n,) index of the clip of each value.
    """
    spreads = (ratio(np.bincount(group, values), np.bincount(group)) for group in (participants, clips))
    return crossed(np.asarray(values.mean()), *spreads)
