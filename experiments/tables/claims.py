"""Tests of the paper's claims that one row is better than another, corrected for multiple testing."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy import stats

from ha2g_jax.metrics.uncertainty import holm, jackknife_variance

HELD, NOT_HELD, UNDECIDED, NOTHING_FOUND = "held", "not held", "undecided", "no difference found"
LEVEL = 0.95  # confidence level of every interval, and of all differences of a table together


class Spread(NamedTuple):
    """A mean over `num` seeds and the bounds of its interval, None for one seed."""

    mean: float
    low: float | None
    high: float | None
    num: int


class Measured(NamedTuple):
    """A score of one run, or a difference of two scores.

    Attributes:
        value: score of all clips.
        without: (groups,) score without each group of clips in turn, such as those of a recording or of a speaker;
            empty if unknown, so that nothing can be said about other recordings or speakers.
    """

    value: float
    without: np.ndarray = np.zeros(0)


class Mean(NamedTuple):
    """A mean over `num` seeds with its standard error, None where it cannot be estimated, of degrees of freedom."""

    value: float
    error: float | None
    freedom: float
    num: int


class Claim(NamedTuple):
    """A claim of the paper and the difference that tests it.

    Attributes:
        difference: mean of the reference minus the row, None without a seed that both have.
        is_higher_better: whether a higher value of the measure is better.
        is_comparable: whether the paper claims instead that the two rows are comparable.
    """

    difference: Mean | None
    is_higher_better: bool
    is_comparable: bool = False


class Verdict(NamedTuple):
    """Result of the test of one claim.

    Attributes:
        difference: reference minus row with its interval; the intervals of all claims hold together. None without
            seeds that both rows have.
        p_value: p-value with Holm's correction, None without an error.
        verdict: `HELD`, `NOT_HELD`, `UNDECIDED` or `NOTHING_FOUND`.
    """

    difference: Spread | None
    p_value: float | None
    verdict: str


def over_seeds(values: Sequence[float]) -> Spread:
    """Compute the mean of n seeds with the t interval of `LEVEL` for n - 1 degrees of freedom."""
    return interval(combine([Measured(value) for value in values]))


def combine(runs: Sequence[Measured]) -> Mean:
    """Compute a mean over seeds with an error that holds for other seeds and, where known, for other groups of clips.

    The error is se^2 = s^2 / n + v, with s the standard deviation over n seeds and v the jackknife variance of the mean
    over the groups; the degrees of freedom are those of Welch and Satterthwaite. Because s contains a part of v, the
    error tends to be too large rather than too small.

    There is no error for one seed, for one group, or where a score without one of the groups is unknown.
    """
    values = np.array([run.value for run in runs])
    without = np.mean([run.without for run in runs], axis=0)
    mean, num, count = float(values.mean()), len(values), len(without)
    if num < 2 or count == 1 or not np.isfinite(without).all():
        return Mean(mean, None, 0.0, num)
    seeds = values.var(ddof=1) / num
    groups = jackknife_variance(without)
    total = seeds + groups
    if total == 0:
        return Mean(mean, 0.0, num - 1, num)
    freedom = total**2 / (seeds**2 / (num - 1) + groups**2 / max(count - 1, 1))
    return Mean(mean, float(np.sqrt(total)), float(freedom), num)


def interval(mean: Mean, tail: float = 1 - LEVEL) -> Spread:
    """Compute the t interval of a mean, which misses with a probability of `tail`; no bounds without an error."""
    if mean.error is None:
        return Spread(mean.value, None, None, mean.num)
    half = float(stats.t.ppf(1 - tail / 2, mean.freedom)) * mean.error
    return Spread(mean.value, mean.value - half, mean.value + half, mean.num)


def paired(reference: Mapping[int, Measured], row: Mapping[int, Measured]) -> Mean | None:
    """Compute the mean difference of two rows over the seeds that both have.

    Seeds are paired: runs with the same seed have the same order of windows, so that a part of the noise cancels.

    Returns:
        Reference minus row, or None without a common seed.
    """
    pairs = [(reference[seed], row[seed]) for seed in sorted(reference.keys() & row.keys())]
    return (
        combine([Measured(one.value - two.value, one.without - two.without) for one, two in pairs]) if pairs else None
    )


def judge(claims: Sequence[Claim]) -> list[Verdict]:
    """Test claims together, so that all true null hypotheses are kept with a probability of `LEVEL`.

    The p-value of a difference is that of Student's t with n - 1 degrees of freedom for n seeds, also where speakers
    are a part of the error, because Welch and Satterthwaite's freedom finds too much in the tails, where corrections
    look. It is corrected for the number of claims by Holm's method (Holm 1979).
    The intervals are Bonferroni's: each has the level 1 - 0.05 / m, for m claims, so that all of them hold together at
    `LEVEL`. Holm's method decides a little more than they do.

    With a corrected p-value above 0.05, or without an error, a claim is undecided. With a smaller one, a claim that two
    rows are comparable is not held; finding no difference does not show that there is none.
    """
    differences = [claim.difference and with_freedom_of_seeds(claim.difference) for claim in claims]
    tested = [difference for difference in differences if difference and difference.error is not None]
    corrected = iter(holm([t_test(difference) for difference in tested]))
    verdicts = []
    for claim, difference in zip(claims, differences, strict=True):
        if difference is None:
            verdicts.append(Verdict(None, None, UNDECIDED))
            continue
        p_value = None if difference.error is None else next(corrected)
        spread = interval(difference, (1 - LEVEL) / max(len(tested), 1))
        verdicts.append(Verdict(spread, p_value, _decide(claim, difference.value, p_value)))
    return verdicts


def _decide(claim: Claim, value: float, p_value: float | None) -> str:
    if p_value is None:
        return UNDECIDED
    if p_value > 1 - LEVEL:
        return NOTHING_FOUND if claim.is_comparable else UNDECIDED
    is_ahead = (value > 0) == claim.is_higher_better
    return HELD if is_ahead and not claim.is_comparable else NOT_HELD


def with_freedom_of_seeds(mean: Mean) -> Mean:
    """Return a mean over n seeds with at most n - 1 degrees of freedom, see `judge`."""
    return mean._replace(freedom=min(mean.freedom, mean.num - 1))


def t_test(difference: Mean) -> float:
    """Compute the two-sided p-value of a difference with an error, that of Student's t."""
    if not difference.error:  # all seeds have the same difference: any but 0 is beyond chance
        return float(difference.value == 0)
    return float(2 * stats.t.sf(abs(difference.value) / difference.error, difference.freedom))
