"""Times of events: local minima of a curve, distances to the nearest other time, and the kernel of a distance."""

from typing import NamedTuple

import numpy as np

SIGMA = 0.1  # seconds, width of the kernel between onsets and motion beats


class Minima(NamedTuple):
    """Local minima of a curve.

    Attributes:
        sample: (n,) index of the lowest sample, of the first where two are equal.
        offset: (n,) from there to the lowest point of the parabola through it and its neighbours, -0.5 to 0.5 samples.
        rise: (n,) from the lowest sample to the nearest local maximum, on the side where that is less.
    """

    sample: np.ndarray
    offset: np.ndarray
    rise: np.ndarray


def deep_minima(curve: np.ndarray, rise: float) -> np.ndarray:
    """Return the places, between samples, of strict local minima of a curve (T,) that rise by `rise` on both sides."""
    found = minima(curve)
    return (found.sample + found.offset)[found.rise >= rise]


def minima(curve: np.ndarray, *, is_first: np.ndarray | None = None, equal: bool = False) -> Minima:
    """Find the strict local minima of one curve, or of many that lie end to end.

    Args:
        curve: (T,) samples.
        is_first: (T,) whether a sample is the first of its curve; no minimum is there, at a last sample, or across.
        equal: whether two equal lowest samples count too, as a minimum halfway.
    """
    is_joint = np.zeros(max(len(curve) - 1, 0), bool) if is_first is None else is_first[1:]
    steps = np.diff(curve)
    falls, rises, stays = (np.zeros(len(curve), bool) for _ in range(3))  # towards a sample, and away from it
    falls[1:], rises[:-1], stays[:-1] = (sign & ~is_joint for sign in (steps < 0, steps > 0, steps == 0))
    is_lowest = falls & rises
    if equal:
        is_lowest[:-1] |= falls[:-1] & stays[:-1] & rises[1:]
    index = np.flatnonzero(is_lowest)
    samples = np.arange(len(curve))
    left = np.maximum.accumulate(np.where(falls, 0, samples))[index]
    right = np.minimum.accumulate(np.where(rises, len(curve), samples)[::-1])[::-1][index + stays[index]]
    before, after = curve[index - 1] - curve[index], curve[index + 1] - curve[index]
    return Minima(
        index, 0.5 * (before - after) / (before + after), np.minimum(curve[left], curve[right]) - curve[index]
    )


def nearest(
    times: np.ndarray, others: np.ndarray, owners: np.ndarray | None = None, other_owners: np.ndarray | None = None
) -> np.ndarray:
    """Return the seconds (n,) from each time to the nearest of the others, infinite where there is none.

    Args:
        times, others: (n,) and (m,) ascending seconds.
        owners, other_owners: (n,) and (m,) ascending clips that the times belong to; only times of the same clip meet.
            Times then ascend within a clip. All belong to one clip by default.
    """
    if not len(others):
        return np.full(len(times), np.inf)
    if owners is None or other_owners is None:
        owners, other_owners = np.zeros(len(times), int), np.zeros(len(others), int)
    low = min(times.min(initial=0), others.min())
    span = max(times.max(initial=0), others.max()) - low + 1
    after = np.searchsorted(other_owners * span + (others - low), owners * span + (times - low))
    distances = np.full(len(times), np.inf)
    # The rounding of the long axis may pick a neighbour that is slightly farther; distances are taken on the times.
    for neighbour in (np.maximum(after - 1, 0), np.minimum(after, len(others) - 1)):
        candidates = np.where(other_owners[neighbour] == owners, np.abs(others[neighbour] - times), np.inf)
        np.minimum(distances, candidates, out=distances)
    return distances


def kernel(distances: np.ndarray, sigma: float = SIGMA) -> np.ndarray:
    """Return exp(-d^2 / (2 sigma^2)) of distances d in seconds (HA2G, Eq. 11); 0 at infinity."""
    return np.exp(-np.square(distances) / (2 * sigma**2))
