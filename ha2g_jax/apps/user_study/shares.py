"""Shares of choices with intervals and tests: of matched motion among those that prefer one, or of one system."""

from typing import NamedTuple

import numpy as np
from scipy import special, stats

from ha2g_jax.apps.user_study.crossed import LEVEL, Spread, degrees_of_freedom, ratio
from ha2g_jax.apps.user_study.observations import Choices


class Share(NamedTuple):
    """The share of choices that prefer the first stimulus of their pairs.

    Attributes:
        first: number of choices for the first stimulus.
        equal: number of choices for neither.
        second: number of choices for the second stimulus.
        value: first / (first + second); NaN without such choices.
        low: lower bound over participants and clips.
        high: upper bound over participants and clips.
        p: p-value of the hypothesis that the share is a half, for the same sampling as the interval.
        exact_low: lower bound of Clopper and Pearson, as if all choices were independent.
        exact_high: upper bound of Clopper and Pearson.
        exact_p: p-value of the exact binomial test, as if all choices were independent.
        with_half: (first + equal / 2) / all, the share if equal choices count half.
    """

    first: int
    equal: int
    second: int
    value: float
    low: float
    high: float
    p: float
    exact_low: float
    exact_high: float
    exact_p: float
    with_half: float


def share(choices: Choices) -> Share:
    """Return the share of choices for the first stimulus among those that prefer one, with intervals and tests.

    Args:
        choices: choices, of which those for neither are only counted.
    """
    first, equal, second = (int((choices.outcome == outcome).sum()) for outcome in (1, 0, -1))
    decided = first + second
    if not decided:
        none = np.nan
        return Share(first, equal, second, none, none, none, none, none, none, none, 0.5 if equal else none)
    kept = choices.where(choices.outcome != 0)
    participants, clips = (
        ratio(np.bincount(group, kept.outcome == 1), np.bincount(group)) for group in (kept.participant, kept.clip)
    )
    low, high, p = interval(np.asarray(first / decided), np.asarray(decided), participants, clips)
    test = stats.binomtest(first, decided)
    exact = test.proportion_ci(LEVEL, method="exact")
    with_half = (first + equal / 2) / (decided + equal)
    return Share(
        *(first, equal, second, first / decided, float(low), float(high), float(p)),
        *(exact.low, exact.high, float(test.pvalue), with_half),
    )


def interval(
    value: np.ndarray, count: np.ndarray, participants: Spread, clips: Spread, level: float = LEVEL
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the bounds and the p-value of a share, for choices that depend on participants and clips.

    Korn and Graubard 1998: the interval of Clopper and Pearson for n* choices in place of n, with
    n* = value (1 - value) / variance, and times (t_(n - 1) / t_d)^2, because the variance is estimated with d degrees
    of freedom. n* is at most n. A share of 0 or 1 has no variance: there n* is the number of participants, as if each
    of them would always choose the same.

    Args:
        value: (...) share.
        count: (...) number of choices n.
        participants: variance of the share over participants.
        clips: variance of the share over clips.
        level: confidence level.

    Returns:
        Lower bound, upper bound, and the two-sided p-value of a share of a half: twice the smaller tail of the binomial
        distribution, below 1 - level where the interval excludes a half.
    """
    variance = participants.variance + np.where(clips.size > 1, clips.variance, 0.0)
    freedom = degrees_of_freedom(participants, clips)
    tail = (1 - level) / 2
    with np.errstate(invalid="ignore", divide="ignore"):
        quantiles = stats.t.isf(tail, np.maximum(count - 1, 1)) / stats.t.isf(tail, freedom)
        effective = value * (1 - value) / variance * np.square(quantiles)
        effective = np.where((value == 0) | (value == 1), participants.size, np.minimum(effective, count))
        effective = np.where(np.isnan(variance), np.nan, effective)
        first, second = value * effective, (1 - value) * effective
        low = np.where(first > 0, special.betaincinv(first, second + 1, tail), 0.0 * effective)
        high = np.where(second > 0, special.betaincinv(first + 1, second, 1 - tail), 1.0 + 0.0 * effective)
        at_least = np.where(first > 0, special.betainc(first, second + 1, 0.5), 1.0)
        at_most = np.where(second > 0, special.betainc(second, first + 1, 0.5), 1.0)
        p = np.minimum(1.0, 2 * np.minimum(at_least, at_most) + 0.0 * effective)
    return low, high, p
