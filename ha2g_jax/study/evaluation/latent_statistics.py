"""Frechet distance and diversity of the rows of an evaluation, from latents of their windows."""

import functools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from ha2g_jax.data.records import WINDOW_FRAMES
from ha2g_jax.metrics import diversity, frechet
from ha2g_jax.metrics.frechet import Moments
from ha2g_jax.study.evaluation.metrics import FGD, FGD_SEEDED
from ha2g_jax.study.evaluation.performance import SEED_FRAMES
from ha2g_jax.study.evaluation.rows import Row

NUM_HALVES = 20  # random divisions of ground truth

_NUM_PAIRS, _NUM_DRAWS = 500, 10

Statistic = Callable[[np.ndarray], float]
"""A score from how often each source is drawn, (sources,); ones for the score itself."""


class Cut(NamedTuple):
    """Where windows begin.

    Attributes:
        metric: `FGD` where the seed pose is not in them, else `FGD_SEEDED`.
        first_frame: of the first window of a clip; another follows each one without overlap.
    """

    metric: str
    first_frame: int

    def starts(self, num_frames: int) -> range:
        return range(self.first_frame, num_frames - WINDOW_FRAMES + 1, WINDOW_FRAMES)


class Latents(NamedTuple):
    """Latents of a row's windows.

    Attributes:
        latents: (n, d).
        members: (n,) index of each one's source.
        inputs: (n,) index of the speech that each one is of: a place in a clip.
    """

    latents: np.ndarray
    members: np.ndarray
    inputs: np.ndarray


def choose_cut(lengths: Sequence[int]) -> Cut | None:
    """How clips of these lengths are cut; None where none is as long as a window.

    The seed pose is left out of the windows unless most clips that are as long as a window would have none then.
    """
    windows = sum(length >= WINDOW_FRAMES for length in lengths)
    unseeded = sum(length >= WINDOW_FRAMES + SEED_FRAMES for length in lengths)
    if not windows:
        return None
    return Cut(FGD, SEED_FRAMES) if 2 * unseeded >= windows else Cut(FGD_SEEDED, 0)


def encode(row: Row, members: np.ndarray, cut: Cut, features: Callable[[np.ndarray], np.ndarray]) -> Latents:
    """The latents of a row.

    Args:
        row: of the evaluation.
        members: (clips of the reference,) index of each one's source.
        cut: where windows begin.
        features: (n, 34, bones, 3) -> (n, d).
    """
    places = [
        (number, start)
        for directions, number in zip(row.directions, row.numbers, strict=True)
        for start in cut.starts(len(directions))
    ]
    _, inputs = np.unique(places, axis=0, return_inverse=True)
    return Latents(features(cut_windows(row, cut)), members[[number for number, _ in places]], inputs)


def cut_windows(row: Row, cut: Cut) -> np.ndarray:
    """Windows (n, 34, bones, 3) float32 of all clips of a row, of which at least one is as long."""
    windows = [
        directions[start : start + WINDOW_FRAMES]
        for directions in row.directions
        for start in cut.starts(len(directions))
    ]
    return np.stack(windows).astype(np.float32)


class SourceMoments:
    """Moments of latents by source, from which those of any draw of sources follow at once."""

    def __init__(self, latents: Latents, num_sources: int):
        self.num_sources = num_sources
        self._centre = latents.latents.mean(axis=0)  # so that what is subtracted below is small
        dim = latents.latents.shape[1]
        self._sizes, self._sums = np.zeros(num_sources), np.zeros((num_sources, dim))
        self._squares = np.zeros((num_sources, dim * dim))
        for source in np.unique(latents.members):
            own = latents.latents[latents.members == source] - self._centre
            self._sizes[source], self._sums[source] = len(own), own.sum(axis=0)
            self._squares[source] = (own.T @ own).reshape(-1)

    def pool(self, counts: np.ndarray) -> Moments:
        """Moments of the latents of sources drawn `counts` (sources,) times each."""
        size = float(counts @ self._sizes)
        if not size:
            return Moments(0, self._centre, np.zeros((len(self._centre),) * 2))
        mean = counts @ self._sums / size
        squares = (counts @ self._squares).reshape(len(mean), len(mean))
        return Moments(int(size), self._centre + mean, squares - size * np.outer(mean, mean))


def distance(row: SourceMoments, truth: SourceMoments) -> Statistic:
    """FGD of a row; a draw takes the same sources of both sides."""
    if row is truth:  # which would be 0 a thousand times
        value = frechet.distance(row.pool(np.ones(row.num_sources)), truth.pool(np.ones(row.num_sources)))
        return lambda counts: value
    return lambda counts: frechet.distance(row.pool(counts), truth.pool(counts))


def half_distances(latents: Latents, seed: int) -> np.ndarray:
    """FGD between random halves of the sources, (NUM_HALVES,)."""
    return frechet.half_split_floor(latents.latents, latents.members, num_draws=NUM_HALVES, seed=seed)


def diversity_draws(latents: Latents, seed: int) -> diversity.Draws:
    """Diversity in ten draws of 500 pairs (HA2G, Table 12)."""
    return diversity.diversity(latents.latents, latents.members, num_pairs=_NUM_PAIRS, num_draws=_NUM_DRAWS, seed=seed)


def diversity_statistics(latents: Latents, seed: int) -> tuple[Statistic, Statistic]:
    """Diversity L1 and L2 of one draw of 500 pairs; copies of one source are never paired.

    So an interval holds what chance does to the choice of 500 pairs, as it does to the published numbers.
    """
    windows = np.arange(len(latents.members))

    @functools.cache
    def both(drawn: bytes) -> tuple[float, float]:
        chosen = np.repeat(windows, np.frombuffer(drawn, np.int64)[latents.members])
        found = diversity.diversity(
            latents.latents[chosen], latents.members[chosen], num_pairs=_NUM_PAIRS, num_draws=1, seed=seed
        )
        return float(found.l1[0]), float(found.l2[0])

    def drawn(counts: np.ndarray) -> bytes:
        return np.asarray(counts, np.int64).tobytes()

    return lambda counts: both(drawn(counts))[0], lambda counts: both(drawn(counts))[1]


def multimodality_statistic(latents: Latents) -> Statistic | None:
    """Mean L1 distance between the performances of one and the same speech; None where no clip has several."""
    groups = [np.flatnonzero(latents.inputs == place) for place in np.unique(latents.inputs)]
    groups = [group for group in groups if len(group) > 1]
    if not groups:
        return None
    distances = np.array([diversity.multimodality(latents.latents[group][None]) for group in groups])
    sources = latents.members[[group[0] for group in groups]]

    def mean(counts: np.ndarray) -> float:
        weights = counts[sources]
        return float(weights @ distances / weights.sum()) if weights.any() else np.nan

    return mean
