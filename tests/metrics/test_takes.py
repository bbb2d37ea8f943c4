"""The energy distance is 0 for sets of one distribution, and sees both a wrong place and a lack of variety."""

import numpy as np
import pytest

from ha2g_jax.metrics.takes import TAKE_METRICS, CauseRow, energy_distance, take_distances


def takes(count: int, seed: int, scale: float = 0.1, place: float = 0.0) -> np.ndarray:
    """Takes (n, 10, 2, 3) that each stand at a random place."""
    places = np.random.default_rng(seed).normal(place, scale, (count, 1, 1, 3))
    return np.broadcast_to(places, (count, 10, 2, 3))


def energy(first: np.ndarray, second: np.ndarray) -> float:
    return energy_distance(np.array([take_distances(first, second)]))


def test_equal_distributions_are_near_and_others_far():
    true = takes(60, 0)
    size = take_distances(true, true).second
    assert abs(energy(takes(60, 1), true)) < 0.05 * size
    assert energy(takes(60, 1, scale=0.02), true) > 0.2 * size  # too much alike
    assert energy(takes(60, 1, place=0.2), true) > size
    assert energy(np.zeros((1, 10, 2, 3)), true) > 0.4 * size


def test_distances_by_hand():
    first, second = np.zeros((1, 5, 2, 3)), np.zeros((2, 5, 2, 3))
    second[1, :, 0] = (0.03, 0.04, 0)  # one of two joints is 5 cm away
    assert take_distances(first, second) == pytest.approx((1.25, 0, 2.5))
    scores = {
        metric.name: metric.measure(CauseRow(takes=np.array([(4.0, 2, 4), (4, 4, 4)]))) for metric in TAKE_METRICS
    }
    assert [getattr(score, "value", None) for score in scores.values()] == pytest.approx([1, 3, 0.75])
    assert all(metric.measure(CauseRow()) is None for metric in TAKE_METRICS)


def test_takes_of_different_lengths_are_refused():
    with pytest.raises(ValueError, match=r"shapes \(5, 2, 3\) and \(1, 2, 3\)"):
        take_distances(np.zeros((1, 5, 2, 3)), np.zeros((2, 1, 2, 3)))
