"""Audio encoder of HA2G-ASR (Table 3): features of a trained Whisper encoder in place of E_a."""

import jax
import jax.numpy as jnp
import numpy as np
from flax import linen as nn

from ha2g_jax.features.asr_mel import ASR_COLUMNS_PER_SECOND
from ha2g_jax.layers import initializers
from ha2g_jax.layers.resnet_se import Features
from ha2g_jax.layers.whisper import WhisperEncoder

_POSITIONS_PER_SECOND = ASR_COLUMNS_PER_SECOND / 2


def feature_blocks(layers: int) -> tuple[int, int, int]:
    """The blocks, from 0, whose features are low, middle and high: the first, the one halfway and the last (D5)."""
    return 0, (layers + 1) // 2 - 1, layers - 1


def resample(x: jax.Array, num_frames: int, fps: float) -> jax.Array:
    """Features at the middle of each frame, linear between the two nearest positions.

    Args:
        x: (B, positions, channels), 50 positions a second, the first at time 0.
        num_frames: of the result.
        fps: frames per second; the middle of frame n is at (n + 0.5) / fps.

    Returns:
        (B, num_frames, channels).

    Raises:
        ValueError: the last frame's middle lies past the last position.
    """
    place = (np.arange(num_frames) + 0.5) * (_POSITIONS_PER_SECOND / fps)
    before = np.floor(place).astype(int)
    if before[-1] + 1 >= x.shape[1]:
        raise ValueError(
            f"{x.shape[1]} positions are {x.shape[1] / _POSITIONS_PER_SECOND:.2f} s; expected enough for {num_frames} "
            f"frames at {fps} fps, {num_frames / fps:.2f} s"
        )
    weight = jnp.asarray(place - before, x.dtype)[None, :, None]
    return x[:, before] * (1 - weight) + x[:, before + 1] * weight


class AsrAudioEncoder(nn.Module):
    """Window of Whisper's log-mel to low, middle and high features of each frame (D5).

    Whisper's own parameters are frozen: no gradient reaches them. What is trained is one linear map of each level.

    Attributes:
        whisper: the encoder, whose parameters come from `train.whisper_weights`.
        feature_dim: values per frame and level.
        num_frames: N.
        fps: frames per second.
    """

    inputs = ("asr_mel",)

    whisper: WhisperEncoder
    feature_dim: int = 32
    num_frames: int = 34
    fps: float = 15

    @nn.compact
    def __call__(self, asr_mel: jax.Array, *, train: bool) -> Features:
        """Maps the mel (B, num_mels, 228) of `asr_mel.asr_window` to features (B, N, feature_dim).

        Nothing here depends on `train`: Whisper has no dropout.
        """
        blocks = jax.lax.stop_gradient(self.whisper(asr_mel))
        levels = []
        for name, block in zip(Features._fields, feature_blocks(self.whisper.layers), strict=True):
            x = resample(blocks[block], self.num_frames, self.fps)
            levels.append(nn.Dense(self.feature_dim, kernel_init=initializers.LINEAR, name=name)(x))
        return Features(*levels)
