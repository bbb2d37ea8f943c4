"""Tests of the paper's claims that one row is better than another, by paired differences over seeds."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy import stats

HELD, NOT_HELD, UNDECIDED, NOTHING_FOUND = "held", "not held", "undecided", "no difference found"
LEVEL = 0.95  # confidence level of every interval over seeds


class Spread(NamedTuple):
    """A mean over seeds and its interval.

    Attributes:
        mean: mean over the seeds.
        low: lower bound of the interval, None for one seed.
        high: upper bound of the interval, None for one seed.
        num: number of seeds.
    """

    mean: float
    low: float | None
    high: float | None
    num: int


class Verdict(NamedTuple):
    """Result of the test of one claim.

    Attributes:
        difference: reference minus row over the seeds that both have; None without such seeds.
        verdict: `HELD`, `NOT_HELD`, `UNDECIDED` or `NOTHING_FOUND`.
    """

    difference: Spread | None
    verdict: str


def over_seeds(values: Sequence[float]) -> Spread:
    """Compute the mean over seeds with the t interval of `LEVEL` for n - 1 degrees of freedom.

    Args:
        values: one value for each of n seeds.
    """
    array = np.asarray(values, float)
    mean, count = float(array.mean()), len(array)
    if count < 2:
        return Spread(mean, None, None, count)
    half = float(stats.t.ppf(0.5 + LEVEL / 2, count - 1) * array.std(ddof=1) / np.sqrt(count))
    return Spread(mean, mean - half, mean + half, count)


def judge(
    reference: Mapping[int, float], row: Mapping[int, float], *, is_higher_better: bool, is_comparable: bool = False
) -> Verdict:
    """Test whether the reference is better than a row, as the paper claims.

    Seeds are paired: runs with the same seed have the same order of windows, so that a part of the noise cancels. With
    an interval that contains 0, or with one seed, the claim is undecided. A claim that two rows are comparable is not
    held where the interval excludes 0; that no difference was found does not show that there is none.

    Args:
        reference: seed -> value of a metric for the reference.
        row: seed -> value of the same metric for the row.
        is_higher_better: whether a higher value of the metric is better.
        is_comparable: whether the paper claims instead that the two rows are comparable.

    Returns:
        The difference and the verdict.
    """
    seeds = sorted(reference.keys() & row.keys())
    if not seeds:
        return Verdict(None, UNDECIDED)
    difference = over_seeds([reference[seed] - row[seed] for seed in seeds])
    if difference.low is None or difference.high is None:
        return Verdict(difference, UNDECIDED)
    if difference.low <= 0 <= difference.high:
        return Verdict(difference, NOTHING_FOUND if is_comparable else UNDECIDED)
    is_ahead = (difference.mean > 0) == is_higher_better
    return Verdict(difference, HELD if is_ahead and not is_comparable else NOT_HELD)
