"""Standard errors of ratios and correlations whose samples come in clusters, such as the words of a clip."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np


class Estimate(NamedTuple):
    """A score with its standard error (NaN where fewer than two clusters leave it undefined)."""

    value: float
    error: float


def jackknife(samples: np.ndarray, statistic: Callable[[np.ndarray], float], clusters: np.ndarray) -> Estimate:
    """Return the statistic of all samples and the delete-one-cluster standard error.

    se^2 = (G - 1) / G sum_g (s_g - mean s)^2, with s_g the statistic without cluster g (Efron and Tibshirani 1993,
    chapter 11). No random numbers: the same samples give the same error.

    Args:
        samples: (n, ...) samples, one row each; a row may hold several quantities of the sample.
        statistic: function of any non-empty subset of the rows to a number.
        clusters: (n,) label of each sample's cluster (a clip or a speaker).
    """
    if not len(samples):
        return Estimate(np.nan, np.nan)
    labels = np.unique(clusters)
    value = float(statistic(samples))
    if len(labels) < 2:
        return Estimate(value, np.nan)
    parts = np.array([statistic(samples[clusters != label]) for label in labels])
    variance = (len(labels) - 1) / len(labels) * np.sum(np.square(parts - parts.mean()))
    return Estimate(value, float(np.sqrt(variance)))
