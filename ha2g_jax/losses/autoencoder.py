"""The terms of the pose auto-encoder of the Frechet gesture distance, each unweighted."""

import jax
import jax.numpy as jnp

from ha2g_jax.skeleton import normalize


def reconstruction(poses: jax.Array, targets: jax.Array) -> jax.Array:
    """The mean absolute error of poses (B, N, pose_dim)."""
    return jnp.mean(jnp.abs(poses - targets))


def velocity(poses: jax.Array, targets: jax.Array) -> jax.Array:
    """The mean absolute error of the differences between neighbouring frames of poses (B, N, pose_dim)."""
    return jnp.mean(jnp.abs(jnp.diff(poses, axis=1) - jnp.diff(targets, axis=1)))


def cosine(directions: jax.Array, target_directions: jax.Array) -> jax.Array:
    """1 - cosine between direction vectors (B, N, bones, 3), the mean over all of them."""
    return jnp.mean(1 - jnp.sum(normalize(directions) * normalize(target_directions), axis=-1))
