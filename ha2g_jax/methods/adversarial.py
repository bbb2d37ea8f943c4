"""The adversarial loss of the generator and of the discriminator, for logits of any shape (B, ...)."""

import jax
import jax.numpy as jnp

GAN_KINDS = ("non_saturating", "minimax", "least_squares")


def gan_generator(fake_logits: jax.Array, *, kind: str = "non_saturating") -> jax.Array:
    """Return the loss of the generator (HA2G, Eq. 6), the mean over the batch of

        non_saturating: -log D(G)        minimax: log(1 - D(G))        least_squares: (1 - D(G))^2

    Args:
        fake_logits: (B, ...) outputs of the discriminator for generated poses, before the sigmoid, which the least
            squares (Mao et al. 2017) do not use.
        kind: one of `GAN_KINDS`.

    Returns:
        () loss.

    Raises:
        ValueError: unknown `kind`.
    """
    if kind == "non_saturating":
        return jnp.mean(jax.nn.softplus(-fake_logits))
    if kind == "minimax":
        return -jnp.mean(jax.nn.softplus(fake_logits))
    if kind == "least_squares":
        return jnp.mean(jnp.square(1 - fake_logits))
    raise ValueError(f"unknown kind of adversarial loss: {kind!r}")


def gan_discriminator(real_logits: jax.Array, fake_logits: jax.Array, *, kind: str = "non_saturating") -> jax.Array:
    """Return the loss of the discriminator, -log D(p) - log(1 - D(G)), or (1 - D(p))^2 + D(G)^2 for least squares.

    Args:
        real_logits, fake_logits: (B, ...) outputs of the discriminator for true and generated poses, before the
            sigmoid.
        kind: one of `GAN_KINDS`.

    Returns:
        () loss, the mean over the batch.
    """
    if kind == "least_squares":
        return jnp.mean(jnp.square(1 - real_logits)) + jnp.mean(jnp.square(fake_logits))
    return jnp.mean(jax.nn.softplus(-real_logits)) + jnp.mean(jax.nn.softplus(fake_logits))
