"""Diversity: the distance between the gestures of a set in the latent space of the pose auto-encoder."""

import functools
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ha2g_jax.metrics.metric import LIKENESS, Metric, Statistic
from ha2g_jax.metrics.row import Latents, Row, mean_by_recording, row_latents

NUM_PAIRS, NUM_DRAWS = 500, 10


class Draws(NamedTuple):
    """Mean distance between the pairs of each random draw (NaN where there is no pair)."""

    l1: np.ndarray
    l2: np.ndarray


def diversity(
    latents: np.ndarray,
    recordings: np.ndarray,
    *,
    num_pairs: int = NUM_PAIRS,
    num_draws: int = NUM_DRAWS,
    seed: int = 0,
) -> Draws:
    """Compute the mean distance between gestures of different recordings, in random draws of pairs (Tables 1 and 12).

    Pairs are unordered, distinct within a draw, and never of one recording, whose overlapping windows differ little.
    All pairs are equally likely. If there are at most `num_pairs`, each draw has them all. The latents are (n, d), the
    labels of their recordings (n,), and the L1 and L2 distances (num_draws,) each.

    Raises:
        ValueError: not as many labels as latents.
    """
    latents = np.asarray(latents, np.float64)
    if len(latents) != len(recordings):
        raise ValueError(f"{len(recordings)} labels of {len(latents)} latents; expected one for each")
    _, members, sizes = np.unique(np.asarray(recordings), return_inverse=True, return_counts=True)
    order = np.argsort(members, kind="stable")
    # In the order of recordings, a row is paired with every row behind its own recording; pair k is found by counting.
    ends = np.repeat(np.cumsum(sizes), sizes)
    last = np.cumsum(len(order) - ends)  # number of the first pair that is not of this row or an earlier one
    total = int(last[-1]) if len(last) else 0
    rng = np.random.default_rng(seed)
    distances = np.full((2, num_draws), np.nan)
    for draw in range(num_draws if total else 0):
        pairs = rng.choice(total, num_pairs, replace=False) if num_pairs < total else np.arange(total)
        first = np.searchsorted(last, pairs, side="right")
        second = len(order) - (last[first] - pairs)
        difference = latents[order[first]] - latents[order[second]]
        distances[:, draw] = np.abs(difference).sum(axis=1).mean(), np.linalg.norm(difference, axis=1).mean()
    return Draws(*distances)


def multimodality(latents: np.ndarray) -> float:
    """Compute the mean L1 distance between latents (samples, d) for one speech; 0 for a method without randomness."""
    first, second = np.triu_indices(len(latents), k=1)
    return float(np.abs(latents[first] - latents[second]).sum(axis=1).mean())


def _both(latents: Latents, seed: int) -> Callable[[np.ndarray], tuple[float, float]]:
    """Return diversity L1 and L2 for any draw of recordings, of 500 pairs, copies of one never among them.

    Those of the recordings themselves are means of ten draws of pairs, as in `row_draws`.
    """
    windows = np.arange(len(latents.members))

    @functools.cache
    def both(drawn: bytes) -> tuple[float, float]:
        counts = np.frombuffer(drawn, np.int64)
        chosen = np.repeat(windows, counts[latents.members])
        num_draws = NUM_DRAWS if (counts == 1).all() else 1
        found = diversity(latents.latents[chosen], latents.members[chosen], num_draws=num_draws, seed=seed)
        return float(found.l1.mean()), float(found.l2.mean())

    return lambda counts: both(np.asarray(counts, np.int64).tobytes())


def _row_statistic(row: Row) -> Callable[[np.ndarray], tuple[float, float]] | None:
    latents = row.once(row_latents)
    return None if latents is None else _both(latents, row.reference.seed)


def _norm(index: int) -> Callable[[Row], Statistic | None]:
    def measure(row: Row) -> Statistic | None:
        both = row.once(_row_statistic)
        return None if both is None else lambda counts: both(counts)[index]

    return measure


def row_draws(row: Row) -> Draws | None:
    """Compute diversity in ten draws of 500 pairs (HA2G, Table 12); None without latents."""
    latents = row.once(row_latents)
    if latents is None:
        return None
    return diversity(latents.latents, latents.members, seed=row.reference.seed)


def _draws(index: int) -> Callable[[Row], np.ndarray | None]:
    def draws(row: Row) -> np.ndarray | None:
        found = row.once(row_draws)
        return None if found is None else found[index]

    return draws


def _multimodality(row: Row) -> Statistic | None:
    """Return the distance between motions for the same speech; None where no clip has several."""
    latents = row.once(row_latents)
    if latents is None:
        return None
    groups = [np.flatnonzero(latents.inputs == place) for place in np.unique(latents.inputs)]
    groups = [group for group in groups if len(group) > 1]
    if not groups:
        return None
    distances = [multimodality(latents.latents[group]) for group in groups]
    members = latents.members[[group[0] for group in groups]]
    return mean_by_recording(distances, members, row.reference.num_recordings)


DIVERSITY_L1 = Metric(
    "diversity_l1", "diversity L1", "", "higher", LIKENESS, 2, _norm(0), draws=_draws(0), is_paired=True
)
DIVERSITY_L2 = Metric("diversity_l2", "diversity L2", "", "higher", LIKENESS, 2, _norm(1), draws=_draws(1))
MULTIMODALITY = Metric("multimodality", "multimodality L1", "", "higher", LIKENESS, 2, _multimodality, is_paired=True)
