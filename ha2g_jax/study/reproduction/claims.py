"""The paper's claims against our seeds: is one row ahead of another, by the paired difference over the seeds."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy import stats

HELD, NOT_HELD, UNDECIDED, NOTHING_FOUND = "held", "not held", "undecided", "no difference found"
LEVEL = 0.95  # of every interval over seeds


class Spread(NamedTuple):
    """A mean over seeds; the interval is None where there is one seed."""

    mean: float
    low: float | None
    high: float | None
    num: int


class Verdict(NamedTuple):
    """What the seeds say of one claim.

    Attributes:
        difference: reference less row, by the seeds that both have; None without any.
        verdict: `HELD`, `NOT_HELD`, `UNDECIDED` or `NOTHING_FOUND`.
    """

    difference: Spread | None
    verdict: str


def over_seeds(values: Sequence[float]) -> Spread:
    """Return the mean of one value a seed, with the t interval of `LEVEL` for n - 1 degrees of freedom."""
    array = np.asarray(values, float)
    mean, count = float(array.mean()), len(array)
    if count < 2:
        return Spread(mean, None, None, count)
    half = float(stats.t.ppf(0.5 + LEVEL / 2, count - 1) * array.std(ddof=1) / np.sqrt(count))
    return Spread(mean, mean - half, mean + half, count)


def judge(
    reference: Mapping[int, float], row: Mapping[int, float], *, is_higher_better: bool, is_comparable: bool = False
) -> Verdict:
    """Return whether the reference is ahead of a row, as the paper claims.

    Seeds are paired: those of a pair have the same order of windows, so that part of the noise cancels. An interval
    that covers 0 decides nothing, nor does one seed. A claim that two are about the same is not held where the interval
    leaves 0 out; that no difference was found does not show that there is none.

    Args:
        reference, row: seed -> value of a metric.
        is_higher_better: of this metric.
        is_comparable: the paper claims that the two are about the same, instead.
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
