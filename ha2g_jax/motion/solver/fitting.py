"""The one rotation that fits several directions best."""

from collections.abc import Sequence

import numpy as np

from ha2g_jax.motion import rotations


def fit(seen: Sequence[np.ndarray], rest: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Wahba's problem: the rotation with the least squared distances between directions turned and directions seen.

    From the singular values of sum seen rest^T (F. L. Markley, "Attitude determination using vector observations and
    the singular value decomposition", 1988).

    Args:
        seen: (T, 3) unit vectors, an array for each direction.
        rest: (3,) unit vectors, the same directions at rest.

    Returns:
        (T, 4) rotations and (T,) how sure they are: 1 for directions as at rest, 0 where all lie on one line.
    """
    products = np.einsum("kti,kj->tij", np.stack(seen), np.stack(rest))
    u, sizes, vt = np.linalg.svd(products)
    sign = np.where(np.linalg.det(u) * np.linalg.det(vt) < 0, -1.0, 1.0)
    u[..., 2] *= sign[:, None]
    at_rest = np.linalg.svd(np.einsum("ki,kj->ij", np.stack(rest), np.stack(rest)), compute_uv=False)
    surety = (sizes[:, 1] + sign * sizes[:, 2]) / (at_rest[1] + at_rest[2])
    return rotations.from_matrix(u @ vt), np.clip(surety, 0, 1)
