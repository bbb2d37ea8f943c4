"""Least-squares fit of a rotation to several directions."""

from collections.abc import Sequence

import numpy as np

from ha2g_jax.motion import rotations


def fit(seen: Sequence[np.ndarray], rest: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Fit the rotation from directions at rest to observed directions by least squares (Wahba's problem).

    The rotation follows from the singular value decomposition of sum seen rest^T (F. L. Markley, "Attitude
    determination using vector observations and the singular value decomposition", 1988).

    Args:
        seen: observed directions, a (T, 3) array of unit vectors for each.
        rest: the same directions at rest, a (3,) unit vector for each.

    Returns:
        (T, 4) rotations, and (T,) certainties from 0, where all directions lie on one line, to 1, where they lie to
        each other as at rest.
    """
    products = np.einsum("kti,kj->tij", np.stack(seen), np.stack(rest))
    u, sizes, vt = np.linalg.svd(products)
    sign = np.where(np.linalg.det(u) * np.linalg.det(vt) < 0, -1.0, 1.0)
    u[..., 2] *= sign[:, None]
    at_rest = np.linalg.svd(np.einsum("ki,kj->ij", np.stack(rest), np.stack(rest)), compute_uv=False)
    certainty = (sizes[:, 1] + sign * sizes[:, 2]) / (at_rest[1] + at_rest[2])
    return rotations.from_matrix(u @ vt), np.clip(certainty, 0, 1)
