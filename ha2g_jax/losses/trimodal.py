"""The terms in which Trimodal differs from HA2G (Yoon et al. 2020)."""

import jax
import jax.numpy as jnp
import optax

_STYLE_DELTA = 0.05
_MIN_STYLE_DISTANCE = 1e-5


def style(
    poses: jax.Array, other_poses: jax.Array, z: jax.Array, other_z: jax.Array, *, clip: float = 1000.0
) -> jax.Array:
    """Style diverging loss, the mean over the batch of

        - min(Huber(p(z_1), p(z_2)) / (mean |z_1 - z_2| + 1e-5), epsilon)

    Huber's function over its delta of 0.05, summed over frames and dimensions; HA2G's version divides by the sum of
    |z_1 - z_2|. `other_poses` and both styles are detached here, so that only the first output moves.

    Args:
        poses, other_poses: (B, N, pose_dim) outputs for the two styles.
        z, other_z: (B, 16) the styles.
        clip: epsilon.
    """
    other_poses, z, other_z = jax.lax.stop_gradient((other_poses, z, other_z))
    distance = jnp.sum(optax.losses.huber_loss(poses, other_poses, delta=_STYLE_DELTA), axis=(1, 2)) / _STYLE_DELTA
    style_distance = jnp.mean(jnp.abs(z - other_z), axis=-1)
    return -jnp.mean(jnp.minimum(distance / (style_distance + _MIN_STYLE_DISTANCE), clip))


def kld(mean: jax.Array, log_variance: jax.Array) -> jax.Array:
    """KL divergence of the styles from N(0, I), the mean over the batch and over the values of a style.

    Args:
        mean, log_variance: (B, 16) of the Gaussian a style is sampled from.
    """
    return -0.5 * jnp.mean(1 + log_variance - mean**2 - jnp.exp(log_variance))
