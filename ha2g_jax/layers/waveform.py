"""Encoder of raw speech that Joint Embedding and Trimodal share (Yoon et al. 2020)."""

import jax
from flax import linen as nn

from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.layers import initializers
from ha2g_jax.layers.conv import BatchNorm
from ha2g_jax.layers.resampling import frame_centres, interpolate

_KERNEL = 15
_CHANNELS = (16, 32, 64)
_STRIDES = (5, 6, 6, 6)
_PADDING = 1600  # samples of silence on each side of the window, so that each frame becomes one step
_SLOPE = 0.3
# Of the steps after all convolutions: samples from one to the next, and the sample in the middle of step 0.
_STEP, _FIRST = 1080, -88


class WaveformEncoder(nn.Module):
    """Encoder from the samples of a window to one feature per frame, by four strided convolutions.

    At the paper's size 36,267 samples become 7,891, 1,313, 217 and 34 steps of 16, 32, 64 and `feature_dim` channels,
    one step for each frame. If a window does not have as many steps as frames, the steps are interpolated.
    """

    feature_dim: int = 32
    num_frames: int = 34
    fps: float = 15

    inputs = ("audio",)

    @nn.compact
    def __call__(self, audio: jax.Array, *, train: bool) -> jax.Array:
        """Map the samples of a window at 16 kHz, -1 to 1, (B, samples) to features (B, N, feature_dim)."""
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
        if x.shape[1] == self.num_frames:
            return x
        places = (frame_centres(self.num_frames, self.fps) * SAMPLE_RATE - _FIRST) / _STEP
        return interpolate(x, places, axis=1)
