"""Text encoder E_t: a temporal convolutional network of weight-normalised dilated convolutions.

Bai, Kolter and Koltun 2018; HA2G, supplement B. Blocks have kernel 2 and dilations 1, 2, 4, 8.
"""

import jax
import jax.numpy as jnp
from flax import linen as nn

from ha2g_jax.layers import initializers
from ha2g_jax.layers.linear import Embedding

_KERNEL = 2
_EMBEDDING_DROPOUT = 0.1


class WeightNormConv(nn.Module):
    """Convolution over frames whose kernel is scale * v / |v|, with one norm for each output channel.

    Attributes:
        dilation: number of frames between the two taps.
        padding: number of frames of zeros (before, after); their sum is `dilation`, so that N frames stay N.
    """

    channels: int
    dilation: int
    padding: tuple[int, int]

    @nn.compact
    def __call__(self, x: jax.Array) -> jax.Array:
        """Map (B, N, inputs) to (B, N, channels)."""
        kernel = self.param("kernel", initializers.LINEAR, (_KERNEL, x.shape[-1], self.channels))
        # The scale starts at the kernel's norm, so that the normalised kernel starts as `kernel`.
        scale = self.param("scale", lambda _: _norm(kernel))
        bias = self.param("bias", nn.initializers.zeros, (self.channels,), jnp.float32)
        normalised = (kernel * (scale / _norm(kernel))[None, None]).astype(x.dtype)
        # Both taps side by side on the channels are one matrix product. The kernel gradient of XLA's convolution needs
        # transposes on a CPU, which take longer than the product.
        padded, num_frames = jnp.pad(x, ((0, 0), self.padding, (0, 0))), x.shape[1]
        taps = jnp.concatenate([padded[:, :num_frames], padded[:, self.dilation :]], axis=-1)
        return taps @ normalised.reshape(-1, self.channels) + bias[None, None]


def _norm(kernel: jax.Array) -> jax.Array:
    return jnp.sqrt(jnp.sum(jnp.square(kernel.astype(jnp.float32)), axis=(0, 1)))


class ResidualBlock(nn.Module):
    """Residual block: [convolution, ReLU, dropout] once or twice, added to the input, then ReLU."""

    channels: int
    dilation: int
    convolutions: int
    padding: tuple[int, int]
    dropout: float

    @nn.compact
    def __call__(self, x: jax.Array, *, train: bool) -> jax.Array:
        """Map (B, N, inputs) to (B, N, channels)."""
        y = x
        for index in range(self.convolutions):
            y = WeightNormConv(self.channels, self.dilation, self.padding, name=f"conv_{index}")(y)
            y = nn.Dropout(self.dropout)(nn.relu(y), deterministic=not train)
        if x.shape[-1] != self.channels:
            x = nn.Dense(self.channels, kernel_init=initializers.normal(0.01), name="shortcut")(x)
        return nn.relu(x + y)


class TextEncoder(nn.Module):
    """Encoder from the word of each frame to one feature per frame.

    The receptive field of a frame (decision D4) is

      "centred": 16 words, from 8 frames before to 7 after. One convolution per block; the taps of dilation d are
        ceil(d / 2) frames before and floor(d / 2) frames after the frame, so that each block is centred and its
        residual path stays aligned.
      "causal": 31 words, those of the frame and the past. Two convolutions per block, padded on the left.

    Attributes:
        vocabulary_size: number of rows of the word table; row 0 is the padding, which is trained like the others.
        layers: number of blocks; block i has dilation 2^i.
        dropout: dropout rate after each convolution.
    """

    vocabulary_size: int
    embedding_dim: int = 300
    channels: int = 300
    layers: int = 4
    feature_dim: int = 32
    receptive_field: str = "centred"
    dropout: float = 0.3

    @nn.compact
    def __call__(self, words: jax.Array, *, train: bool) -> jax.Array:
        """Map word indices (B, N) to features (B, N, feature_dim)."""
        centred = self.receptive_field == "centred"
        spread = initializers.normal(self.embedding_dim**-0.5)
        x = Embedding(self.vocabulary_size, self.embedding_dim, embedding_init=spread, name="embedding")(words)
        x = nn.Dropout(_EMBEDDING_DROPOUT if self.dropout else 0.0)(x, deterministic=not train)
        for index in range(self.layers):
            dilation = 2**index
            x = ResidualBlock(
                channels=self.channels,
                dilation=dilation,
                convolutions=1 if centred else 2,
                padding=(dilation - dilation // 2, dilation // 2) if centred else (dilation, 0),
                dropout=self.dropout,
                name=f"block_{index}",
            )(x, train=train)
        return nn.Dense(self.feature_dim, kernel_init=initializers.normal(0.01), name="linear")(x)
