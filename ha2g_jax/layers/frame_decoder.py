"""The recurrent decoder that Joint Embedding, Trimodal and the release of HA2G share (Yoon et al. 2020)."""

import jax
from flax import linen as nn

from ha2g_jax.layers import initializers
from ha2g_jax.layers.gru import BiGRU


class FrameDecoder(nn.Module):
    """Decoder of the features of each frame to a pose: a bidirectional GRU and two linear maps.

    Attributes:
        pose_dim: number of values of a flat pose.
        hidden_dim, layers, dropout: settings of the GRU, see `BiGRU`; the first linear map has half its width.
        slope: slope of the activation for negative values. The release of Trimodal passes True in its place, which
            makes it 1 and the activation the identity.
    """

    pose_dim: int
    hidden_dim: int
    layers: int
    dropout: float
    slope: float = 0.01

    @nn.compact
    def __call__(self, x: jax.Array, *, train: bool) -> jax.Array:
        """Map features (B, N, inputs) to poses (B, N, pose_dim)."""
        hidden = BiGRU(self.hidden_dim, self.layers, self.dropout, name="gru")(x, train=train)
        hidden = nn.Dense(self.hidden_dim // 2, kernel_init=initializers.LINEAR, name="linear_1")(hidden)
        hidden = nn.leaky_relu(hidden, self.slope)
        return nn.Dense(self.pose_dim, kernel_init=initializers.LINEAR, name="linear_2")(hidden)
