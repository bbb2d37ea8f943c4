"""The adversary: the discriminator of HA2G and Trimodal (Table 8), and the losses of both players (Eq. 6)."""

import jax
import jax.numpy as jnp
from flax import linen as nn

from ha2g_jax.layers import initializers
from ha2g_jax.layers.conv import BatchNorm
from ha2g_jax.layers.gru import BiGRU
from ha2g_jax.layers.linear import Linear


class Discriminator(nn.Module):
    """Discriminator of the poses of a window: three convolutions, a bidirectional GRU, two linear maps.

    At the size of the paper 34 x 126 poses become 28 x 8, then 28 x 64 (directions summed), 28 and 1.

    Attributes:
        layers: number of layers of the GRU; Table 8 states none, the configs and the authors' release have 4.
        slope: slope of the activations for negative values; the release of HA2G has 0.01, that of Trimodal 1.
    """

    hidden_dim: int = 64
    layers: int = 4
    dropout: float = 0.3
    slope: float = 0.2

    @nn.compact
    def __call__(self, poses: jax.Array, *, train: bool) -> jax.Array:
        """Map mean-subtracted poses (B, N, pose_dim) to logits (B,); the loss applies the sigmoid."""
        x = _conv(16, name="conv_1")(poses)
        x = nn.leaky_relu(BatchNorm(name="norm_1")(x, train=train), self.slope)
        x = _conv(8, name="conv_2")(x)
        x = nn.leaky_relu(BatchNorm(name="norm_2")(x, train=train), self.slope)
        x = _conv(8, name="conv_3")(x)
        x = BiGRU(self.hidden_dim, self.layers, self.dropout, name="gru")(x, train=train)
        x = Linear(1, name="linear_1")(x)[..., 0]
        return Linear(1, name="linear_2")(x)[..., 0]


def _conv(channels: int, *, name: str) -> nn.Conv:
    return nn.Conv(channels, (3,), padding="VALID", kernel_init=initializers.LINEAR, name=name)


def gan_generator(fake_logits: jax.Array, *, kind: str = "non_saturating") -> jax.Array:
    """Return the adversarial loss of the generator (HA2G, Eq. 6), the mean over the batch of

        non_saturating: -log D(G)        minimax: log(1 - D(G))        least_squares: (1 - D(G))^2

    where D(G) is the sigmoid of the discriminator's logits (B, ...). The least-squares loss (Mao et al. 2017) takes
    the logits themselves.
    """
    match kind:
        case "minimax":
            return -jnp.mean(jax.nn.softplus(fake_logits))
        case "least_squares":
            return jnp.mean(jnp.square(1 - fake_logits))
    return jnp.mean(jax.nn.softplus(-fake_logits))


def gan_discriminator(real_logits: jax.Array, fake_logits: jax.Array, *, kind: str = "non_saturating") -> jax.Array:
    """Return the loss of the discriminator, -log D(p) - log(1 - D(G)), or (1 - D(p))^2 + D(G)^2 for least squares.

    The loss is the mean over the batch; logits are (B, ...) and kinds the same as in `gan_generator`.
    """
    if kind == "least_squares":
        return jnp.mean(jnp.square(1 - real_logits)) + jnp.mean(jnp.square(fake_logits))
    return jnp.mean(jax.nn.softplus(-real_logits)) + jnp.mean(jax.nn.softplus(fake_logits))
