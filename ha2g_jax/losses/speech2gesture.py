"""The term of Speech2Gesture beside the adversarial one (Ginosar et al., CVPR 2019)."""

import jax
import jax.numpy as jnp


def l1(poses: jax.Array, targets: jax.Array) -> jax.Array:
    """Mean absolute error over batch, all frames and dimensions.

    Args:
        poses, targets: (B, N, pose_dim), mean-subtracted.
    """
    return jnp.mean(jnp.abs(poses - targets))
