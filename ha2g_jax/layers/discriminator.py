"""GAN discriminator D (HA2G, Table 8)."""

import jax
from flax import linen as nn

from ha2g_jax.layers import initializers
from ha2g_jax.layers.gru import BiGRU
from ha2g_jax.layers.norm import BatchNorm


class Discriminator(nn.Module):
    """Discriminator of the poses of a window: three convolutions, a bidirectional GRU, two linear maps.

    At the size of the paper 34 x 126 poses become 28 x 8, then 28 x 64 (directions summed), 28 and 1.

    Attributes:
        hidden_dim: number of values of the state of the GRU in one direction.
        layers: number of layers of the GRU; Table 8 states none, the configs and the authors' release have 4.
        dropout: dropout rate between the layers of the GRU.
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
        x = nn.Dense(1, kernel_init=initializers.LINEAR, name="linear_1")(x)[..., 0]
        return nn.Dense(1, kernel_init=initializers.LINEAR, name="linear_2")(x)[..., 0]


def _conv(channels: int, *, name: str) -> nn.Conv:
    return nn.Conv(channels, (3,), padding="VALID", kernel_init=initializers.LINEAR, name=name)
