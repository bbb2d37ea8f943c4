"""Intervals of statistics of crossed answers: each is by one participant, about one clip, and both are sampled.

The variance of a statistic is that over participants plus that over clips, each by the delete-one jackknife (Efron and
Tibshirani 1993, chapter 11). In a complete design these are the two mean squares of the tests F1 and F2, and their sum
is the denominator of min F' (Clark 1973). The part of the variance that is due to single answers is in both, so that
the interval tends to be too wide rather than too narrow.
"""

import itertools
from typing import NamedTuple

import numpy as np
from scipy import special, stats

from ha2g_jax.apps.user_study.answers import Choices

LEVEL = 0.95
"""Confidence level of every interval of a report."""

_ROUNDING = 1e-6  # a variance below the square of this, relative to the statistic, is that of rounding
_CHUNK = 256  # participants left out at a time
_RIDGE, _TOLERANCE = 1e-10, 1e-5  # of the equations of the differences


class CrossedEstimate(NamedTuple):
    """A statistic, or an array of them, with bounds and a standard error, NaN where they are undefined.

    Attributes:
        freedom: degrees of freedom of the t distribution.
        p: two-sided p-value of the hypothesis that the statistic is 0.
    """

    value: np.ndarray
    low: np.ndarray
    high: np.ndarray
    error: np.ndarray
    freedom: np.ndarray
    p: np.ndarray


class Spread(NamedTuple):
    """Variance of a statistic over participants or over clips, and the number of these."""

    variance: np.ndarray
    size: np.ndarray


def jackknife(parts: np.ndarray, is_used: np.ndarray | None = None) -> Spread:
    """Return the delete-one variance, (G - 1) / G sum_g (s_g - mean s)^2.

    `parts` (..., G) are the statistic without each of the G participants or clips, and `is_used` says which have
    answers, by default all. The variance (...) is NaN if fewer than two are used or one of these statistics is
    undefined.
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
) -> CrossedEstimate:
    """Return the t interval of a statistic over participants and clips.

    The variance is v_p + v_c, but at least `least`, with (v_p + v_c)^2 / (v_p^2 / (P - 1) + v_c^2 / (C - 1)) degrees of
    freedom, as for min F' (Clark 1973). With one clip the interval is only about participants. With one participant, or
    if all answers agree, there is no interval, because nothing is known about how much others would differ.
    """
    variance, freedom = _total(participants, clips)
    variance = np.maximum(variance, least)
    error = np.sqrt(np.where(variance > 0, variance, np.nan))
    with np.errstate(invalid="ignore", divide="ignore"):
        half = stats.t.ppf(0.5 + level / 2, freedom) * error
        ratio = np.abs(value) / error
        p = np.where(value == 0, 1.0, 2 * stats.t.sf(ratio, freedom))
    p = np.where(np.isnan(error), np.nan, p)
    return CrossedEstimate(np.asarray(value), value - half, value + half, error, freedom, p)


def _total(participants: Spread, clips: Spread) -> tuple[np.ndarray, np.ndarray]:
    of_clips = np.where(clips.size > 1, clips.variance, 0.0)
    total = participants.variance + of_clips
    squares = np.square(participants.variance) / np.maximum(participants.size - 1, 1)
    squares = squares + np.square(of_clips) / np.maximum(clips.size - 1, 1)
    freedom = np.square(total) / np.where(squares > 0, squares, 1.0)
    return total, np.where(squares > 0, freedom, np.maximum(participants.size - 1, 1))


def ratio(sums: np.ndarray, counts: np.ndarray) -> Spread:
    """Return the delete-one variance of sum / count (..., G), over the answers of each of G participants or clips."""
    left = counts.sum(-1, keepdims=True) - counts
    is_used = counts > 0
    parts = np.where(is_used & (left > 0), (sums.sum(-1, keepdims=True) - sums) / np.maximum(left, 1), np.nan)
    return jackknife(np.where(is_used, parts, 0.0), is_used)


def mean(values: np.ndarray, participants: np.ndarray, clips: np.ndarray) -> CrossedEstimate:
    """Return the mean of values (n,), at least one, with its interval over the participants and clips of each."""
    spreads = (ratio(np.bincount(group, values), np.bincount(group)) for group in (participants, clips))
    return crossed(np.asarray(values.mean()), *spreads)


class Share(NamedTuple):
    """The share of choices that prefer the first stimulus of their pairs.

    Attributes:
        first, equal, second: numbers of choices for the first stimulus, for neither, and for the second one.
        value: first / (first + second); NaN without such choices.
        low, high: bounds over participants and clips.
        p: p-value of the hypothesis that the share is a half, for the same sampling as the interval.
        exact_low, exact_high: bounds of Clopper and Pearson, as if all choices were independent.
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
    """Return the share of choices for the first stimulus among those that prefer one, with intervals and tests."""
    first, equal, second = (int((choices.outcome == outcome).sum()) for outcome in (1, 0, -1))
    decided = first + second
    if not decided:
        return Share(first, equal, second, *[np.nan] * 7, with_half=0.5 if equal else np.nan)
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

    Korn and Graubard 1998: the interval of Clopper and Pearson for n* choices instead of n, with
    n* = value (1 - value) / variance, times (t_(n - 1) / t_d)^2, because the variance is estimated with d degrees of
    freedom. n* is at most n. A share of 0 or 1 has no variance; then n* is the number of participants, as if each of
    them always chose the same. `count` is the number n of choices, and `value` the share.

    Returns:
        Lower bound, upper bound, and the two-sided p-value of a share of a half: twice the smaller tail of the binomial
        distribution, below 1 - level where the interval excludes a half.
    """
    variance, freedom = _total(participants, clips)
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


def system_differences(
    scores: np.ndarray, participants: np.ndarray, clips: np.ndarray, systems: np.ndarray, num_systems: int
) -> CrossedEstimate:
    """Return the paired differences of mean scores of all pairs of systems, in the order of `itertools.combinations`.

    They come from least squares with an effect of each system, participant and clip: score = system + participant +
    clip + rest. In a complete design this is the difference of the means; in an incomplete one, participants who rate
    low and hard clips do not count against a system. An interval includes the variation between participants and
    between clips.

    The scores (n,) are by a participant, about a clip and a system, whose indices are (n,), too.

    Returns:
        Estimates (pairs,): first system minus second. NaN if no answers connect the two, for example because every
        participant rated only one system, and NaN bounds if this is so without one of the participants or clips.
    """
    shape = (participants.max() + 1, num_systems, clips.max() + 1)
    cells = np.ravel_multi_index((participants, systems, clips), shape)
    counts = np.bincount(cells, minlength=np.prod(shape)).reshape(shape).astype(float)
    sums = np.bincount(cells, scores, minlength=np.prod(shape)).reshape(shape)
    is_there = counts.sum((1, 2)) > 0
    counts, sums = counts[is_there], sums[is_there]
    used = counts.sum((0, 1)) > 0
    counts, sums = counts[..., used], sums[..., used]
    matrix, right = _normal_equations(counts, sums)
    value = _solve(matrix[None], right[None], num_systems)[0]
    without_participant = []
    for start in range(0, len(counts), _CHUNK):
        one_by_one = range(start, min(start + _CHUNK, len(counts)))
        matrices, rights = zip(*(_normal_equations(counts[it][None], sums[it][None]) for it in one_by_one), strict=True)
        without_participant += [*_solve(matrix - np.stack(matrices), right - np.stack(rights), num_systems)]
    without_clip = []
    for clip in range(counts.shape[2]):
        left = np.arange(counts.shape[2]) != clip
        matrix, right = _normal_equations(counts[..., left], sums[..., left])
        without_clip.append(_solve(matrix[None], right[None], num_systems)[0])
    return crossed(value, jackknife(np.array(without_participant).T), jackknife(np.array(without_clip).T))


def _normal_equations(counts: np.ndarray, sums: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the normal equations of systems and clips, from which the effects of the participants are eliminated.

    They are a matrix (S + C, S + C) and a right side (S + C,), from the numbers and the sums of ratings (P, S, C).
    """
    num_systems = counts.shape[1]
    seen = np.concatenate([counts.sum(2), counts.sum(1)], axis=1)
    scored = np.concatenate([sums.sum(2), sums.sum(1)], axis=1)
    total = np.maximum(counts.sum((1, 2)), 1)
    matrix = np.diag(seen.sum(0))
    matrix[:num_systems, num_systems:] = counts.sum(0)
    matrix[num_systems:, :num_systems] = counts.sum(0).T
    matrix -= (seen / total[:, None]).T @ seen
    return matrix, (scored - seen * (sums.sum((1, 2)) / total)[:, None]).sum(0)


def _solve(matrices: np.ndarray, rights: np.ndarray, num_systems: int) -> np.ndarray:
    """Return the differences of all pairs of systems (batch, pairs), NaN where the equations do not determine them."""
    first, second = np.array(list(itertools.combinations(range(num_systems), 2)), int).reshape(-1, 2).T
    contrasts = np.zeros((len(first), matrices.shape[-1]))
    contrasts[np.arange(len(first)), first], contrasts[np.arange(len(first)), second] = 1, -1
    # The equations are singular, as a constant can move from the systems to the clips; a small ridge fixes it, and
    # shows in the weights of a contrast that the equations do not determine.
    ridge = _RIDGE * (1 + matrices.trace(axis1=1, axis2=2)[:, None, None]) * np.eye(matrices.shape[-1])
    weights = np.linalg.solve(matrices + ridge, contrasts.T).transpose(0, 2, 1)  # (batch, pairs, S + C)
    is_determined = np.abs(weights @ matrices - contrasts).max(-1, initial=0.0) < _TOLERANCE
    return np.where(is_determined, (weights @ rights[..., None])[..., 0], np.nan)


def fleiss_kappa(table: np.ndarray) -> float:
    """Return Fleiss' kappa, (P - P_e) / (1 - P_e).

    P is the mean over items of the share of pairs of answers that agree, sum_j n_ij (n_ij - 1) / (n_i (n_i - 1)), and
    P_e = sum_j p_j^2 with p_j the mean over items of n_ij / n_i. Fleiss 1971 has the same number of answers n_i for all
    items; with other numbers these are the means of Gwet 2014, and items with fewer than two answers do not count. The
    table (items, categories) has the numbers of answers n_ij.

    Returns:
        Kappa: 1 for perfect agreement, 0 for that of chance; NaN if no item has two answers, or if all answers of the
        table are of one category, where chance agrees perfectly as well.
    """
    table = table[table.sum(1) > 1]
    if not len(table):
        return np.nan
    totals = table.sum(1)
    agreement = np.mean((table * (table - 1)).sum(1) / (totals * (totals - 1)))
    chance = np.square(np.mean(table / totals[:, None], axis=0)).sum()
    return float((agreement - chance) / (1 - chance)) if chance < 1 - 1e-12 else np.nan


def agreement(participants: np.ndarray, clips: np.ndarray, items: np.ndarray, answers: np.ndarray) -> CrossedEstimate:
    """Return Fleiss' kappa of answers (n,), which agree if equal, with an interval over participants and clips (n,)."""
    _, item = np.unique(items, return_inverse=True)
    _, category = np.unique(answers, return_inverse=True)
    shape = (item.max() + 1, category.max() + 1)

    def table(is_kept: np.ndarray) -> np.ndarray:
        cells = np.ravel_multi_index((item[is_kept], category[is_kept]), shape)
        return np.bincount(cells, minlength=shape[0] * shape[1]).reshape(shape)

    value = np.asarray(fleiss_kappa(table(np.ones(len(item), bool))))
    spreads = [
        jackknife(np.array([fleiss_kappa(table(groups != group)) for group in np.unique(groups)]))
        for groups in (participants, clips)
    ]
    found = crossed(value, *spreads)
    return found._replace(low=np.maximum(found.low, -1.0), high=np.minimum(found.high, 1.0))
