"""The recurrent decoder that Joint Embedding and Trimodal share (Yoon et al. 2020)."""

import jax
from flax import linen as nn

from ha2g_jax.layers import initializers
from ha2g_jax.layers.gru import BiGRU

# The slope that was meant; the authors' releases pass True for it, which makes the activation the identity.
_SLOPE = 0.01


class FrameDecoder(nn.Module):
    """What is known of each frame to its pose: a bidirectional GRU, then a linear map to half its width and one more.

    Attributes:
        pose_dim: values of a flat pose.
        hidden_dim, layers, dropout: of the GRU.
    """

    pose_dim: int
    hidden_dim: int
    layers: int
    dropout: float

    @nn.compact
    def __call__(self, x: jax.Array, *, train: bool) -> jax.Array:
        """Maps (B, N, inputs) to poses (B, N, pose_dim)."""
        hidden = BiGRU(self.hidden_dim, self.layers, self.dropout, name="gru")(x, train=train)
        hidden = nn.Dense(self.hidden_dim // 2, kernel_init=initializers.LINEAR, name="linear_1")(hidden)
        hidden = nn.leaky_relu(hidden, _SLOPE)
        return nn.Dense(self.pose_dim, kernel_init=initializers.LINEAR, name="linear_2")(hidden)
