"""Frechet gesture distance (FGD) between two sets of latents, from moments that can be gathered in any chunks."""

import functools
import logging
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ha2g_jax.errors import UserError

SAMPLES_PER_DIMENSION = 10  # below, the bias of the distance is of the order of what it should measure
LEGACY_FAILURE = 1e10

_CLOSE = 1e-4  # share of the traces below which their difference has lost digits that matter

_logger = logging.getLogger(__name__)


class Moments(NamedTuple):
    """What the distance needs to know of a set: its size, its mean (d,) and its scatter (d, d) about it, in float64.

    The covariance is scatter / (count - 1).
    """

    count: int  # pyright: ignore[reportIncompatibleMethodOverride]
    mean: np.ndarray
    scatter: np.ndarray


def moments(latents: np.ndarray) -> Moments:
    """Moments of a set of latents (n, d); n may be 0.

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


def merge(a: Moments, b: Moments) -> Moments:
    """Moments of the union of two sets, without the sets (Chan, Golub and LeVeque 1979)."""
    count = a.count + b.count
    if not count:
        return a
    step = b.mean - a.mean
    between = np.outer(step, step) * (a.count / count * b.count)
    return Moments(count, a.mean + step * (b.count / count), a.scatter + b.scatter + between)


def pool(parts: Sequence[Moments], counts: np.ndarray) -> Moments:
    """Moments of a set in which part g occurs counts[g] times: what `bootstrap.bootstrap_counts` needs of an FGD.

    Sources that occur twice make a set less varied than new ones would, so that the distances of resampled sets lie
    above that of the set itself; print `half_split_floor` beside such an interval.

    Args:
        parts: (G,) moments of each source; at least one.
        counts: (G,) how often each is drawn.
    """
    repeated = [
        Moments(part.count * int(times), part.mean, part.scatter * times)
        for part, times in zip(parts, counts, strict=True)
        if times
    ]
    empty = Moments(0, np.zeros_like(parts[0].mean), np.zeros_like(parts[0].scatter))
    return functools.reduce(merge, repeated, empty)


def distance(a: Moments, b: Moments) -> float:
    """Squared Frechet distance of two Gaussians: |mu1 - mu2|^2 + tr S1 + tr S2 - 2 tr sqrt(S1^1/2 S2 S1^1/2).

    With factors F F^T = S, the last trace is the sum of the singular values of F1^T F2 = P D Q^T. Where sets are so
    close that little is left of the three traces, |F1 P - F2 Q|^2 takes their place, which is the same number: it
    subtracts matrices, not large traces, so that it is never negative, and singular covariances cost no accuracy. What
    is below the rounding of the traces is 0, so that equal sets are at 0 in whatever chunks they were gathered.

    Args:
        a: moments of one set, in units of the latents.
        b: moments of the other set.

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


def is_too_few(count: int, latent_dim: int) -> bool:
    """Whether a set of latents is too small for its distance to be taken at face value (n < 10 d)."""
    return count < SAMPLES_PER_DIMENSION * latent_dim


def half_split_floor(latents: np.ndarray, sources: np.ndarray, *, num_draws: int = 10, seed: int = 0) -> np.ndarray:
    """Distance of one half of a set to the other half: what an FGD cannot be expected to fall below.

    Whole sources go to either half, in random order until about half of the latents are dealt.

    Args:
        latents: (n, d) latents of real motion.
        sources: (n,) label of each latent's source.
        num_draws: number of random splits.
        seed: seed of the splits.

    Returns:
        (num_draws,) distances; NaN with fewer than two sources or where a half has fewer than two latents.
    """
    labels, members, sizes = np.unique(np.asarray(sources), return_inverse=True, return_counts=True)
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


def extrapolate(
    generated: np.ndarray, real: np.ndarray, *, num_sizes: int = 15, num_draws: int = 5, seed: int = 0
) -> float:
    """The distance that sets without end would have: the intercept of a line through FGD against 1/n.

    Chong and Forsyth 2020 (FID infinity): the bias of the distance falls as 1/n, so that it can be read off subsets of
    several sizes n, evenly spaced from a tenth (but at least 2 d, and at most a half) to the whole of the smaller set.
    Few sources remain few: the bias that comes of them stays. May be slightly negative.

    Args:
        generated: (n, d) latents.
        real: (m, d) latents; where m = n, both sets lose the same rows, as they may be two motions to one speech.
        num_sizes: number of sizes, at least 2.
        num_draws: number of lines, each through its own random subsets, of which the mean intercept is returned.
        seed: seed of the subsets.

    Returns:
        The intercept in squared units of the latents; NaN with fewer than 4 latents in a set.
    """
    generated, real = np.asarray(generated), np.asarray(real)
    most = min(len(generated), len(real))
    if most < 4:
        return np.nan
    least = max(2, min(most // 2, max(most // 10, 2 * real.shape[1])))
    sizes = np.unique(np.linspace(least, most, num_sizes).astype(int))
    rng = np.random.default_rng(seed)
    distances = np.empty((num_draws, len(sizes)))
    for place in np.ndindex(distances.shape):
        size = sizes[place[1]]
        rows = rng.permutation(len(generated))[:size]
        others = rows if len(real) == len(generated) else rng.permutation(len(real))[:size]
        distances[place] = distance(moments(generated[rows]), moments(real[others]))
    return float(np.polyfit(1 / sizes, distances.mean(axis=0), 1)[1])


def legacy_distance(generated: np.ndarray, real: np.ndarray) -> float:
    """FGD as the public release computed it, for comparison only.

    Means in float32, covariances (n - 1) in float64, the general square root of S1 S2 by a Schur decomposition. If the
    root is not finite, 1e-6 is added to both diagonals and the root taken again. A complex root counts by its real part
    unless its diagonal has an imaginary part above 1e-3. What fails then scores 1e10.

    Args:
        generated: (n, d) latents, taken in float32.
        real: (m, d) latents, taken in float32.
    """
    generated, real = np.asarray(generated, np.float32), np.asarray(real, np.float32)
    if min(len(generated), len(real)) < 2 or not (np.isfinite(generated).all() and np.isfinite(real).all()):
        return LEGACY_FAILURE
    step = generated.mean(axis=0) - real.mean(axis=0)
    covariances = [np.atleast_2d(np.cov(rows, rowvar=False)) for rows in (generated, real)]
    root = _schur_root(covariances[0] @ covariances[1])
    if not np.isfinite(root).all():
        _logger.warning("legacy FGD: the product of covariances has no square root; 1e-6 added to their diagonals")
        offset = 1e-6 * np.eye(len(root))
        root = _schur_root((covariances[0] + offset) @ (covariances[1] + offset))
    diagonal = np.diagonal(root)
    if not np.isfinite(root).all() or np.max(np.abs(np.imag(diagonal))) > 1e-3:
        return LEGACY_FAILURE
    traces = np.trace(covariances[0]) + np.trace(covariances[1]) - 2 * np.sum(np.real(diagonal))
    return float(step.dot(step) + traces)


def legacy_feature_distance(generated: np.ndarray, real: np.ndarray) -> float:
    """The release's "feat_D": mean over samples of the L1 distance between a sample's generated and real latent."""
    return float(np.abs(np.asarray(generated, np.float64) - np.asarray(real, np.float64)).sum(axis=1).mean())


def _factor(covariance: np.ndarray) -> np.ndarray:
    """F with F F^T = S: Cholesky's, or where S is singular the symmetric root, negative eigenvalues clipped at 0."""
    try:
        return np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(covariance)
        return (vectors * np.sqrt(np.clip(values, 0, None))) @ vectors.T


@np.errstate(over="ignore", invalid="ignore")  # a root that is not finite has its rule in the caller
def _schur_root(matrix: np.ndarray) -> np.ndarray:
    """The general square root of a matrix, real where it can be, NaN where there is none (Björck and Hammarling 1983).

    Written out, because scipy's `sqrtm` changed with its versions what it makes of singular matrices: 1.17 has 0 for
    the root of 0, 1.18 has infinities, and the legacy value follows.
    """
    from scipy import linalg

    triangle, vectors = linalg.schur(matrix)[:2]
    if np.any(np.tril(triangle, -1)) or np.any(np.diagonal(triangle) < 0):
        triangle, vectors = linalg.rsf2csf(triangle, vectors)
    root = np.diag(np.sqrt(np.diagonal(triangle)))
    rounding = len(root) * np.finfo(np.float64).eps * np.abs(triangle).max()
    for column in range(1, len(root)):
        for row in range(column - 1, -1, -1):
            rest = triangle[row, column] - root[row, row + 1 : column] @ root[row + 1 : column, column]
            scale = root[row, row] + root[column, column]
            if scale == 0 and abs(rest) > rounding:
                return np.full_like(root, np.nan)
            root[row, column] = rest / scale if scale else 0
    return vectors @ root @ vectors.conj().T
