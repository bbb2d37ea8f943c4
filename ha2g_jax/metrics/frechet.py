"""Frechet gesture distance (FGD) between two sets of latents, from moments that can be gathered in any chunks."""

from typing import NamedTuple

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.metrics.metric import LIKENESS, Metric, Score, Statistic
from ha2g_jax.metrics.row import FGD_CUT, FGD_SEEDED_CUT, Latents, Row, row_latents

NUM_HALVES = 20  # random divisions of ground truth
SAMPLES_PER_DIMENSION = 10  # with fewer, the bias of the distance is about as large as the distance

_NUM_LINES = 5  # lines through random subsets, whose intercepts are averaged
_NUM_SIZES = 15  # sizes of subsets, from which the distance of infinite sets is extrapolated
_CLOSE = 1e-4  # ratio to the traces below which their difference has lost significant digits


class Moments(NamedTuple):
    """Size, mean (d,) and scatter (d, d) in float64 of a set of latents; the covariance is scatter / (count - 1)."""

    count: int
    mean: np.ndarray
    scatter: np.ndarray


def moments(latents: np.ndarray) -> Moments:
    """Return the moments of a set of latents (n, d); n may be 0.

    Raises:
        UserError: a latent is not finite.
    """
    latents = np.asarray(latents, np.float64)
    bad = int(np.count_nonzero(~np.isfinite(latents).all(axis=1)))
    if bad:
        raise UserError(
            f"{bad} of {len(latents)} latents are NaN or infinite, expected numbers; look at the motion they come from"
        )
    mean = latents.mean(axis=0) if len(latents) else np.zeros(latents.shape[1])
    centred = latents - mean
    return Moments(len(latents), mean, centred.T @ centred)


def distance(a: Moments, b: Moments) -> float:
    """Compute the squared Frechet distance of two Gaussians.

        |mu1 - mu2|^2 + tr S1 + tr S2 - 2 tr sqrt(S1^1/2 S2 S1^1/2)

    With factors F F^T = S, the last trace is the sum of the singular values of F1^T F2 = P D Q^T. Where sets are so
    close that the three traces nearly cancel, |F1 P - F2 Q|^2 replaces them, which is the same number: it subtracts
    matrices, not large traces, so that it is never negative, and singular covariances cost no accuracy. A distance
    below the rounding error of the traces is 0, so that equal sets have distance 0 in whatever chunks they were
    gathered.

    Returns:
        The distance in squared units of the latents; NaN if a set has fewer than two members.

    Raises:
        UserError: latents of different sizes.
    """
    if a.mean.shape != b.mean.shape:
        raise UserError(
            f"latents of {a.mean.size} and {b.mean.size} numbers, expected one size; "
            "encode both sets with the same auto-encoder"
        )
    if a.count < 2 or b.count < 2:
        return np.nan
    a_factor, b_factor = _factor(a.scatter / (a.count - 1)), _factor(b.scatter / (b.count - 1))
    traces = np.sum(np.square(a_factor)) + np.sum(np.square(b_factor))
    product = a_factor.T @ b_factor
    spread = traces - 2 * np.linalg.svd(product, compute_uv=False).sum()
    if spread < _CLOSE * traces:
        left, _, right = np.linalg.svd(product)
        spread = np.sum(np.square(a_factor @ left - b_factor @ right.T))
    rounding = np.finfo(np.float64).eps * len(product) * traces
    return float(np.sum(np.square(a.mean - b.mean)) + (spread if spread > rounding else 0.0))


def half_split_floor(latents: np.ndarray, recordings: np.ndarray, *, num_draws: int = 10, seed: int = 0) -> np.ndarray:
    """Compute the distances (num_draws,) between halves of a set, below which no FGD can be expected to fall.

    Whole recordings, the labels (n,) of the latents (n, d), are assigned in random order to the first half until it has
    about half of the latents. NaN with fewer than two recordings or where a half has fewer than two latents.
    """
    labels, members, sizes = np.unique(np.asarray(recordings), return_inverse=True, return_counts=True)
    if len(labels) < 2:
        return np.full(num_draws, np.nan)
    latents = np.asarray(latents)
    rng = np.random.default_rng(seed)
    floors = np.empty(num_draws)
    for draw in range(num_draws):
        order = rng.permutation(len(labels))
        dealt = np.cumsum(sizes[order])[:-1]
        cut = 1 + int(np.argmin(np.abs(dealt - len(latents) / 2)))
        is_first = np.isin(members, order[:cut])
        floors[draw] = distance(moments(latents[is_first]), moments(latents[~is_first]))
    return floors


def extrapolate(generated: np.ndarray, real: np.ndarray, *, inputs: np.ndarray | None = None, seed: int = 0) -> float:
    """Estimate the distance of infinite sets, as the intercept of a line through FGD against 1/n.

    Chong and Forsyth 2020 (FID infinity): the bias of the distance falls as 1/n, so that it can be estimated from
    subsets of several sizes n, evenly spaced from a tenth (but at least 2 d, and at most a half) to the whole of the
    smaller set of latents (n, d) and (m, d). The result is the mean intercept of lines through random subsets. The bias
    due to few recordings remains. It may be slightly negative; NaN with fewer than 4 latents in a set.

    Args:
        inputs: (n,) row of the real set with the motion for the same speech, each at least once. Both subsets are then
            of the same speech, with one of several motions for each. By default row k belongs to row k if m = n, else
            the sets are independent.
    """
    generated, real = np.asarray(generated), np.asarray(real)
    if inputs is None and len(real) == len(generated):
        inputs = np.arange(len(real))
    most = min(len(generated), len(real))
    if most < 4:
        return np.nan
    least = max(2, min(most // 2, max(most // 10, 2 * real.shape[1])))
    sizes = np.unique(np.linspace(least, most, _NUM_SIZES).astype(int))
    rng, which = np.random.default_rng(seed), np.random.default_rng([seed, 1])
    distances = np.empty((_NUM_LINES, len(sizes)))
    for place in np.ndindex(distances.shape):
        size = sizes[place[1]]
        others = rng.permutation(len(real))[:size]
        if inputs is None:
            rows = rng.permutation(len(generated))[:size]
        else:  # one motion for each speech, the first in a random order
            order = which.permutation(len(inputs))
            rows = order[np.unique(inputs[order], return_index=True)[1]][others]
        distances[place] = distance(moments(generated[rows]), moments(real[others]))
    return float(np.polyfit(1 / sizes, distances.mean(axis=0), 1)[1])


def _factor(covariance: np.ndarray) -> np.ndarray:
    """Return F with F F^T = S: Cholesky's, or for singular S the symmetric root, with negative eigenvalues set to 0."""
    try:
        return np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(covariance)
        return (vectors * np.sqrt(np.clip(values, 0, None))) @ vectors.T


class RecordingMoments:
    """Moments of latents by recording, from which those of any draw of recordings are computed quickly."""

    def __init__(self, latents: Latents, num_recordings: int):
        self.num_recordings = num_recordings
        self._centre = latents.latents.mean(axis=0)  # so that the terms subtracted below are small
        dim = latents.latents.shape[1]
        self._sizes, self._sums = np.zeros(num_recordings), np.zeros((num_recordings, dim))
        self._squares = np.zeros((num_recordings, dim * dim))
        for member in np.unique(latents.members):
            own = latents.latents[latents.members == member] - self._centre
            self._sizes[member], self._sums[member] = len(own), own.sum(axis=0)
            self._squares[member] = (own.T @ own).reshape(-1)

    def pool(self, counts: np.ndarray) -> Moments:
        """Return the moments of the latents if each recording is drawn `counts` (recordings,) times."""
        size = float(counts @ self._sizes)
        if not size:
            return Moments(0, self._centre, np.zeros((len(self._centre),) * 2))
        mean = counts @ self._sums / size
        squares = (counts @ self._squares).reshape(len(mean), len(mean))
        return Moments(int(size), self._centre + mean, squares - size * np.outer(mean, mean))


def _row_moments(row: Row) -> RecordingMoments | None:
    latents = row.once(row_latents)
    return None if latents is None else RecordingMoments(latents, row.reference.num_recordings)


def _true_moments(row: Row) -> RecordingMoments | None:
    """Return the moments of a row, the cached ones of ground truth if its motion is the true one."""
    is_true = row.directions is row.reference.directions
    return (row.reference.truth if is_true else row).once(_row_moments)


def _distance_to_truth(row: Row, cut: str) -> Statistic | None:
    """Return the FGD of a row, None if windows are cut differently; a draw takes the same recordings of both sets."""
    latents, own, true = row.once(row_latents), row.once(_true_moments), row.reference.truth.once(_true_moments)
    if latents is None or own is None or true is None or latents.cut.name != cut:
        return None
    if own is true:  # all draws would be 0
        every = np.ones(own.num_recordings)
        value = distance(own.pool(every), true.pool(every))
        return lambda counts: value
    return lambda counts: distance(own.pool(counts), true.pool(counts))


def _halves(truth: Row, cut: str) -> np.ndarray | None:
    latents = truth.once(row_latents)
    if latents is None or latents.cut.name != cut:
        return None
    return half_split_floor(latents.latents, latents.members, num_draws=NUM_HALVES, seed=truth.reference.seed)


def _extrapolated(row: Row) -> Score:
    own, true = row.once(row_latents), row.reference.truth.once(row_latents)
    if own is None or true is None or own.cut.name != FGD_CUT:
        return None
    places, order = np.unique(true.inputs, return_index=True)
    inputs = order[np.searchsorted(places, own.inputs)]
    return extrapolate(own.latents, true.latents, inputs=inputs, seed=row.reference.seed)


def _fgd(name: str, title: str, cut: str) -> Metric:
    def measure(row: Row) -> Statistic | None:
        return _distance_to_truth(row, cut)

    return Metric(
        name, title, "", "lower", LIKENESS, 3, measure, halves=lambda truth: _halves(truth, cut), is_paired=True
    )


FGD, FGD_SEEDED = _fgd("fgd", "FGD", FGD_CUT), _fgd("fgd_seeded", "FGD (seeded)", FGD_SEEDED_CUT)
FGD_EXTRAPOLATED = Metric("fgd_extrapolated", "FGD extrapolated", "", "lower", LIKENESS, 3, _extrapolated)
