"""The term of Joint Embedding."""

import jax
import jax.numpy as jnp


def l1(poses: jax.Array, targets: jax.Array) -> jax.Array:
    """The sum over the batch of each window's mean absolute difference, as its authors' code has it.

    Args:
        poses, targets: (B, N, pose_dim), mean-subtracted.
    """
    return jnp.sum(jnp.mean(jnp.abs(poses - targets), axis=(1, 2)))
