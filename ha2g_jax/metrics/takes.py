"""Several takes for one speech compared with takes of the teacher: how much they vary, and the energy distance.

The teacher can be sampled many times, so that the true distribution of the motion given the speech is known. A set of
takes can vary too little, or vary in the wrong manner: the energy distance detects both and is 0 for equal
distributions.
"""

import itertools
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ha2g_jax.metrics.causes import CauseRow
from ha2g_jax.metrics.metric import TAKES, Direction, Metric
from ha2g_jax.metrics.uncertainty import Estimate, jackknife


class TakeDistances(NamedTuple):
    """Mean distances in cm of pairs of takes of one speech: between the sets, within the first and the second."""

    between: float
    first: float
    second: float


def take_distances(first: np.ndarray, second: np.ndarray) -> TakeDistances:
    """Measure two sets of takes (n, T, joints, 3) and (m, T, joints, 3) in metres.

    The distance of two takes is the mean over frames and joints. A set of one take has the distance 0 to itself.

    Raises:
        ValueError: takes of different shapes.
    """
    between = np.mean([_distance(one, other) for one, other in itertools.product(first, second)])
    return TakeDistances(float(between), *(_within(takes) for takes in (first, second)))


def energy_distance(distances: np.ndarray) -> float:
    """Return the energy distance 2 E|X - Y| - E|X - X'| - E|Y - Y'| in cm (Szekely and Rizzo 2013) of two sets.

    It is the mean over rows of `TakeDistances` (n, 3), without the pairs of a take with itself, so that it is 0 on
    average for two sets from the same distribution and may be slightly negative.
    """
    between, first, second = np.mean(distances, axis=0)
    return float(2 * between - first - second)


def _within(takes: np.ndarray) -> float:
    pairs = [_distance(one, other) for one, other in itertools.combinations(takes, 2)]
    return float(np.mean(pairs)) if pairs else 0.0


def _distance(first: np.ndarray, second: np.ndarray) -> float:
    if first.shape != second.shape:
        raise ValueError(f"takes of the shapes {first.shape} and {second.shape}; expected the same (T, joints, 3)")
    return float(100 * np.linalg.norm(first - second, axis=-1).mean())


def _ratio(distances: np.ndarray) -> float:
    _, first, second = np.mean(distances, axis=0)
    return float(first / second) if second else np.nan


def _metric(
    name: str, title: str, unit: str, direction: Direction, digits: int, statistic: Callable[[np.ndarray], float]
) -> Metric:
    """Return a metric of rows of `TakeDistances`, whose standard error is over clips."""

    def measure(row: CauseRow) -> Estimate | None:
        return jackknife(row.takes, statistic, np.arange(len(row.takes))) if len(row.takes) else None

    return Metric(name, title, unit, direction, TAKES, digits, measure, "known_causes")


TAKE_METRICS = (
    _metric("take_energy", "energy distance", "cm", "lower", 1, energy_distance),
    _metric("take_distance", "two takes", "cm", "none", 1, lambda distances: float(distances[:, 1].mean())),
    _metric("take_ratio", "over the teacher's", "", "none", 2, _ratio),
)
