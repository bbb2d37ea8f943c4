"""The terms of Attention Seq2Seq (Yoon et al., ICRA 2019), each unweighted: arrays in, one scalar out."""

import jax
import jax.numpy as jnp

# Square below which the norm of a value that never moves has gradient 0, as a square root has none there.
_MIN_SQUARE = 1e-12


def mse(poses: jax.Array, targets: jax.Array) -> jax.Array:
    """Mean squared error over batch, frames and dimensions.

    Args:
        poses, targets: (B, N, pose_dim), mean-subtracted.
    """
    return jnp.mean(jnp.square(poses - targets))


def continuity(poses: jax.Array) -> jax.Array:
    """How much poses change from frame to frame: sum |y_t - y_(t-1)| / (B N pose_dim).

    Args:
        poses: (B, N, pose_dim), mean-subtracted.
    """
    return jnp.sum(jnp.abs(poses[:, 1:] - poses[:, :-1])) / poses.size


def variance(poses: jax.Array) -> jax.Array:
    """Minus how far poses are from the mean pose: - sum_(b, d) ||y_(b, :, d)||_2 / (B N pose_dim).

    Args:
        poses: (B, N, pose_dim) y, mean-subtracted; the norm is taken along time.
    """
    square = jnp.sum(jnp.square(poses), axis=1)
    return -jnp.sum(jnp.sqrt(jnp.maximum(square, _MIN_SQUARE))) / poses.size
