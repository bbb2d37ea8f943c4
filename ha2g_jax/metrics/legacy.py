"""FGD, Diversity and errors by the rules of the public release, with their faults, for comparison with old tables.

The rules of beat consistency are in `beats.legacy`; `legacy_metrics` registers all of them.
"""

import logging
from typing import NamedTuple

import numpy as np

from ha2g_jax.skeleton import load_skeleton

LEGACY_BATCHES = 500
LEGACY_FAILURE = 1e10

_logger = logging.getLogger(__name__)


class LegacyErrors(NamedTuple):
    """The two errors of the public release, in metres, and in metres per frame^2."""

    joint_mae: float
    acceleration: float


def legacy_distance(generated: np.ndarray, real: np.ndarray) -> float:
    """Compute the FGD by the rules of the release.

    Means in float32, covariances (n - 1) in float64, the general square root of S1 S2 by a Schur decomposition. If the
    root is not finite, 1e-6 is added to both diagonals and the root taken again. A complex root counts by its real part
    unless its diagonal has an imaginary part above 1e-3. What still fails scores 1e10.

    Args:
        generated: (n, d) latents, read in float32.
        real: (m, d) latents, read in float32.
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
    """Compute "feat_D" of the release: the mean L1 distance between the generated and the real latent of a sample."""
    return float(np.abs(np.asarray(generated, np.float64) - np.asarray(real, np.float64)).sum(axis=1).mean())


def legacy_diversity(latents: np.ndarray, batch_size: int, seed: int | np.random.Generator) -> float:
    """Compute the diversity by the rules of the release: whole batches against whole batches.

    The first 500 batches, in order, meet the first 500 of a random permutation of all batches, row by row. The value
    depends on the batch size, and a batch may meet itself. The last, partial batch is dropped.

    Args:
        latents: (n, d) latents in the order of the loader.
        batch_size: number of rows of a batch.
        seed: seed, or a generator whose `permutation(num_batches)` is the second order.

    Returns:
        Mean L1 distance over the rows; NaN without a whole batch.
    """
    num_batches = len(latents) // batch_size
    if not num_batches:
        return np.nan
    batches = np.asarray(latents, np.float64)[: num_batches * batch_size].reshape(num_batches, batch_size, -1)
    others = batches[np.random.default_rng(seed).permutation(num_batches)]
    difference = batches[:LEGACY_BATCHES] - others[:LEGACY_BATCHES]
    return float(np.abs(difference).sum(axis=-1).mean())


def legacy_errors(generated: np.ndarray, real: np.ndarray) -> LegacyErrors:
    """Compute the errors of reconstruction by the rules of the release.

    Bones keep the length of their vectors, the bones are always those of TED-Gesture (the first 9 of any skeleton), the
    joint error is of frames from the 5th on and the acceleration error of all.

    Args:
        generated, real: (n, T, bones, 3) vectors with the mean added, not normalised; bones >= 9, T >= 5.

    Returns:
        Means over everything; running means weighted by batch size give the same.
    """
    skeleton = load_skeleton("ted_gesture")
    lengthened = (skeleton.paths * skeleton.lengths).astype(np.float64)
    first, second = (
        lengthened @ np.asarray(vectors, np.float64)[..., : skeleton.num_bones, :] for vectors in (generated, real)
    )
    difference = second - first
    return LegacyErrors(
        float(np.mean(np.abs(difference[:, 4:]))), float(np.mean(np.abs(np.diff(difference, n=2, axis=1))))
    )


@np.errstate(over="ignore", invalid="ignore")  # a root that is not finite has its rule in the caller
def _schur_root(matrix: np.ndarray) -> np.ndarray:
    """Return the general square root of a matrix, NaN where there is none (Björck and Hammarling 1983).

    Written out, because the result of scipy's `sqrtm` for singular matrices changed with its versions: 1.17 has 0 for
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
