"""The two sides of the adversarial loss, of logits of any shape (B, ...)."""

import jax
import jax.numpy as jnp

GAN_KINDS = ("non_saturating", "minimax", "least_squares")


def gan_generator(fake_logits: jax.Array, *, kind: str = "non_saturating") -> jax.Array:
    """Generator's side (HA2G, Eq. 6), the mean over the batch.

        non_saturating: -log D(G)        minimax: log(1 - D(G))        least_squares: (1 - D(G))^2

    Args:
        fake_logits: (B, ...) discriminator outputs for generated poses; before the sigmoid, which the least squares
            (Mao et al. 2017) do without.
        kind: one of `GAN_KINDS`.
    """
    if kind == "non_saturating":
        return jnp.mean(jax.nn.softplus(-fake_logits))
    if kind == "minimax":
        return -jnp.mean(jax.nn.softplus(fake_logits))
    if kind == "least_squares":
        return jnp.mean(jnp.square(1 - fake_logits))
    raise ValueError(f"unknown kind of adversarial loss: {kind!r}")


def gan_discriminator(real_logits: jax.Array, fake_logits: jax.Array, *, kind: str = "non_saturating") -> jax.Array:
    """Discriminator's side: -log D(p) - log(1 - D(G)), or (1 - D(p))^2 + D(G)^2 of the least squares.

    Args:
        real_logits, fake_logits: (B, ...) discriminator outputs, as in `gan_generator`.
        kind: one of `GAN_KINDS`.
    """
    if kind == "least_squares":
        return jnp.mean(jnp.square(1 - real_logits)) + jnp.mean(jnp.square(fake_logits))
    return jnp.mean(jax.nn.softplus(-real_logits)) + jnp.mean(jax.nn.softplus(fake_logits))
