"""The encoder of Whisper (Radford et al. 2022, section 2.2), with the weights' layout of Linen. Channels last."""

import jax
import jax.numpy as jnp
import numpy as np
from flax import linen as nn

from ha2g_jax.layers import initializers

_EPSILON = 1e-5
_LONGEST_PERIOD = 10_000


def sinusoids(length: int, channels: int) -> np.ndarray:
    """Encodings of positions: sines of half of the channels, then cosines, with wavelengths from 2 pi to 20,000 pi.

    Args:
        length: number of positions.
        channels: an even number from 4.

    Returns:
        (length, channels) float32.
    """
    rates = np.exp(-np.log(_LONGEST_PERIOD) * np.arange(channels // 2) / (channels // 2 - 1))
    angles = np.arange(length)[:, None] * rates[None]
    return np.concatenate([np.sin(angles), np.cos(angles)], axis=1).astype(np.float32)


class SelfAttention(nn.Module):
    """Multi-head self-attention over all positions; keys have no bias.

    Attributes:
        heads: number of heads, a divisor of the channels.
    """

    heads: int

    @nn.compact
    def __call__(self, x: jax.Array) -> jax.Array:
        """Maps (B, positions, d_model) to the same shape."""
        channels = x.shape[-1]

        def split(name: str, *, use_bias: bool = True) -> jax.Array:
            projected = _dense(channels, name, use_bias=use_bias)(x)
            return projected.reshape(*x.shape[:2], self.heads, channels // self.heads)

        # Scores are divided by the root of a head's channels; their softmax is float32.
        mixed = jax.nn.dot_product_attention(split("query"), split("key", use_bias=False), split("value"))
        return _dense(channels, "out")(mixed.reshape(x.shape))


class EncoderBlock(nn.Module):
    """Pre-norm transformer block: x + attention(norm(x)), then x + mlp(norm(x)) with exact GELU.

    Attributes:
        heads: of the attention.
        ffn_dim: width of the hidden layer.
    """

    heads: int
    ffn_dim: int

    @nn.compact
    def __call__(self, x: jax.Array) -> jax.Array:
        """Maps (B, positions, d_model) to the same shape."""
        x = x + SelfAttention(self.heads, name="attention")(_norm("attention_norm")(x))
        hidden = nn.gelu(_dense(self.ffn_dim, "expand")(_norm("mlp_norm")(x)), approximate=False)
        return x + _dense(x.shape[-1], "contract")(hidden)


class WhisperEncoder(nn.Module):
    """Log-mel columns to features, two columns to a position of 20 ms.

    Whisper is trained on 30 s; a shorter input takes the first of its positions. The sizes are tiny's by default.

    Attributes:
        num_mels: mel bands of the input.
        d_model: channels, a multiple of the heads, even and from 4.
        layers: number of blocks.
        heads: of each block's attention.
        ffn_dim: width of each block's hidden layer.
    """

    num_mels: int = 80
    d_model: int = 384
    layers: int = 4
    heads: int = 6
    ffn_dim: int = 1536

    @nn.compact
    def __call__(self, mel: jax.Array) -> tuple[jax.Array, ...]:
        """Features after each block.

        Args:
            mel: (B, num_mels, columns), as from `asr_mel.asr_log_mel`, an even number of columns.

        Returns:
            `layers` arrays (B, columns / 2, d_model), position p centred on column 2 p; the last one is the encoder's
            output, normalised, the others are the sums that the next block takes.

        Raises:
            ValueError: another number of mel bands, or an odd number of columns.
        """
        if mel.shape[1] != self.num_mels or mel.shape[2] % 2:
            raise ValueError(f"mel of shape {mel.shape}: expected (batch, {self.num_mels}, an even number of columns)")
        x = nn.gelu(_conv(self.d_model, 1, "conv_1")(mel.transpose(0, 2, 1)), approximate=False)
        x = nn.gelu(_conv(self.d_model, 2, "conv_2")(x), approximate=False)
        x = x + jnp.asarray(sinusoids(x.shape[1], self.d_model), x.dtype)[None]
        features = []
        for index in range(self.layers):
            features.append(x := EncoderBlock(self.heads, self.ffn_dim, name=f"block_{index}")(x))
        return (*features[:-1], _norm("norm")(x))


def _conv(channels: int, stride: int, name: str) -> nn.Conv:
    return nn.Conv(channels, (3,), strides=stride, padding=((1, 1),), kernel_init=initializers.LINEAR, name=name)


def _dense(channels: int, name: str, *, use_bias: bool = True) -> nn.Dense:
    return nn.Dense(channels, use_bias=use_bias, kernel_init=initializers.LINEAR, name=name)


def _norm(name: str) -> nn.LayerNorm:
    # The variance by its definition: a few channels are so large that E[x^2] - E[x]^2 would lose the others.
    return nn.LayerNorm(epsilon=_EPSILON, use_fast_variance=False, name=name)
