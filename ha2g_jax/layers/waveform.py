"""The encoder of raw speech that Joint Embedding and Trimodal share (Yoon et al. 2020)."""

import jax
from flax import linen as nn

from ha2g_jax.layers import initializers
from ha2g_jax.layers.norm import BatchNorm

_KERNEL = 15
_CHANNELS = (16, 32, 64)
_STRIDES = (5, 6, 6, 6)
_PADDING = 1600  # samples of silence on each side of the window, so that its frames become steps one to one
_SLOPE = 0.3


class WaveformEncoder(nn.Module):
    """The samples of a window to one feature a frame, by four strided convolutions.

    36,267 samples become 7,891, 1,313, 217 and 34 steps of 16, 32, 64 and `feature_dim` channels.

    Attributes:
        feature_dim: output values per frame.
    """

    feature_dim: int = 32

    @nn.compact
    def __call__(self, audio: jax.Array, *, train: bool) -> jax.Array:
        """Maps the samples of a window at 16 kHz, -1 to 1, (B, 36267) to features (B, 34, feature_dim)."""
        x, padding = audio[..., None], _PADDING
        for index, (channels, stride) in enumerate(zip((*_CHANNELS, self.feature_dim), _STRIDES, strict=True), 1):
            if index > 1:
                x = nn.leaky_relu(BatchNorm(name=f"norm_{index - 1}")(x, train=train), _SLOPE)
            x = nn.Conv(
                channels,
                (_KERNEL,),
                stride,
                padding=((padding, padding),),
                kernel_init=initializers.LINEAR,
                name=f"conv_{index}",
            )(x)
            padding = 0
        return x
