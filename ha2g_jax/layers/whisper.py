"""Audio encoder of HA2G-ASR (Table 3): features of a trained Whisper encoder instead of E_a (D5).

The encoder is that of Radford et al. 2022, section 2.2, with weights in the layout of Linen. Channels last.
"""

import jax
import jax.numpy as jnp
import numpy as np
from flax import linen as nn

from ha2g_jax.features.spectrum import ASR_COLUMNS_PER_SECOND
from ha2g_jax.layers import initializers
from ha2g_jax.layers.linear import Linear
from ha2g_jax.layers.resampling import frame_centres, interpolate
from ha2g_jax.layers.resnet_se import Features

_EPSILON = 1e-5
_LONGEST_PERIOD = 10_000
_POSITIONS_PER_SECOND = ASR_COLUMNS_PER_SECOND / 2
_POINTS = 4  # points per frame; they are closer together than positions at any rate from 15 to 30 fps


def sinusoids(length: int, channels: int) -> np.ndarray:
    """Return the encodings of positions (length, channels): sines, then cosines.

    Their wavelengths are from 2 pi to 20,000 pi; the number of channels is even and at least 4.
    """
    rates = np.exp(-np.log(_LONGEST_PERIOD) * np.arange(channels // 2) / (channels // 2 - 1))
    angles = np.arange(length)[:, None] * rates[None]
    return np.concatenate([np.sin(angles), np.cos(angles)], axis=1).astype(np.float32)


class SelfAttention(nn.Module):
    """Multi-head self-attention over all positions, without a bias of the keys."""

    heads: int

    @nn.compact
    def __call__(self, x: jax.Array) -> jax.Array:
        """Map (B, positions, d_model) to the same shape."""
        channels = x.shape[-1]

        def split(name: str, *, use_bias: bool = True) -> jax.Array:
            projected = Linear(channels, use_bias=use_bias, name=name)(x)
            return projected.reshape(*x.shape[:2], self.heads, channels // self.heads)

        # Scores are divided by the square root of the channels of a head; their softmax is float32.
        mixed = jax.nn.dot_product_attention(split("query"), split("key", use_bias=False), split("value"))
        return Linear(channels, name="out")(mixed.reshape(x.shape))


class EncoderBlock(nn.Module):
    """Pre-norm transformer block: x + attention(norm(x)), then x + mlp(norm(x)) with exact GELU."""

    heads: int
    ffn_dim: int

    @nn.compact
    def __call__(self, x: jax.Array) -> jax.Array:
        """Map (B, positions, d_model) to the same shape."""
        x = x + SelfAttention(self.heads, name="attention")(_norm("attention_norm")(x))
        hidden = nn.gelu(Linear(self.ffn_dim, name="expand")(_norm("mlp_norm")(x)), approximate=False)
        return x + Linear(x.shape[-1], name="contract")(hidden)


class WhisperEncoder(nn.Module):
    """Encoder from log-mel columns to features, one position of 20 ms for two columns.

    Whisper is trained on 30 s; a shorter input uses the first positions. The default sizes are those of `tiny`.

    Attributes:
        d_model: number of channels, a multiple of the heads, even and at least 4.
        ffn_dim: number of channels of the hidden layer in each block.
    """

    num_mels: int = 80
    d_model: int = 384
    layers: int = 4
    heads: int = 6
    ffn_dim: int = 1536

    @nn.compact
    def __call__(self, mel: jax.Array) -> tuple[jax.Array, ...]:
        """Return the features after each block.

        Args:
            mel: (B, num_mels, columns) log-mel spectrogram of `features.spectrum.asr_log_mel`, with an even number of
                columns.

        Returns:
            `layers` arrays (B, columns / 2, d_model), position p centred on column 2 p; the last one is the normalised
            output of the encoder, the others are the inputs of the next block.
        """
        x = nn.gelu(_conv(self.d_model, 1, "conv_1")(mel.transpose(0, 2, 1)), approximate=False)
        x = nn.gelu(_conv(self.d_model, 2, "conv_2")(x), approximate=False)
        x = x + jnp.asarray(sinusoids(x.shape[1], self.d_model), x.dtype)[None]
        features = []
        for index in range(self.layers):
            features.append(x := EncoderBlock(self.heads, self.ffn_dim, name=f"block_{index}")(x))
        return (*features[:-1], _norm("norm")(x))


def _conv(channels: int, stride: int, name: str) -> nn.Conv:
    return nn.Conv(channels, (3,), strides=stride, padding=((1, 1),), kernel_init=initializers.LINEAR, name=name)


def _norm(name: str) -> nn.LayerNorm:
    # Not E[x^2] - E[x]^2: a few channels are so large that the others would lose their precision.
    return nn.LayerNorm(epsilon=_EPSILON, use_fast_variance=False, name=name)


def feature_blocks(layers: int) -> tuple[int, int, int]:
    """Return the blocks, from 0, whose features are low, middle and high: the first, the middle, the last (D5)."""
    return 0, (layers + 1) // 2 - 1, layers - 1


def resample(x: jax.Array, num_frames: int, fps: float) -> jax.Array:
    """Return the mean of features (B, positions, channels) over each frame, (B, num_frames, channels).

    There are 50 positions a second, the first at time 0. The mean is over four points, each linear between the two
    nearest positions, so that every position of the window counts. Features at the middle of the frames alone would be
    aliased: a frame at 15 fps has 3.3 positions.
    """
    points = frame_centres(num_frames * _POINTS, fps * _POINTS) * _POSITIONS_PER_SECOND
    values = interpolate(x, points, axis=1)
    return values.reshape(len(x), num_frames, _POINTS, x.shape[-1]).mean(axis=2)


class AsrAudioEncoder(nn.Module):
    """Encoder of a window of Whisper's log-mel to low, middle and high features of each frame (D5).

    Whisper's own parameters are frozen: no gradient reaches them. Only a linear map for each level is trained. The
    features of a block are normalised over their channels, because a few channels of Whisper's residual stream are so
    much larger than the others that they would dominate a linear map.

    Attributes:
        whisper: the encoder, whose parameters `checkpoint.whisper` reads.
    """

    inputs = ("asr_mel",)

    whisper: WhisperEncoder
    feature_dim: int = 32
    num_frames: int = 34
    fps: float = 15

    @nn.compact
    def __call__(self, asr_mel: jax.Array, *, train: bool) -> Features:
        """Map the mel (B, num_mels, columns) of `features.spectrum.asr_window` to features (B, N, feature_dim).

        Nothing here depends on `train`: Whisper has no dropout.
        """
        blocks = jax.lax.stop_gradient(self.whisper(asr_mel))
        levels = []
        for name, block in zip(Features._fields, feature_blocks(self.whisper.layers), strict=True):
            norm = nn.LayerNorm(epsilon=_EPSILON, use_bias=False, use_scale=False, use_fast_variance=False)
            x = resample(norm(blocks[block]), self.num_frames, self.fps)
            levels.append(Linear(self.feature_dim, name=name)(x))
        return Features(*levels)
