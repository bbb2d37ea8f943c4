"""Audio encoder of HA2G-ASR (Table 3): features of a trained Whisper encoder in place of E_a."""

import jax
from flax import linen as nn

from ha2g_jax.features.spectrum import ASR_COLUMNS_PER_SECOND
from ha2g_jax.layers import initializers
from ha2g_jax.layers.resampling import frame_centres, interpolate
from ha2g_jax.layers.resnet_se import Features
from ha2g_jax.layers.whisper import WhisperEncoder

_POSITIONS_PER_SECOND = ASR_COLUMNS_PER_SECOND / 2
_POINTS = 4  # in a frame, closer together than positions at any rate from 15 to 30 fps
_EPSILON = 1e-5


def feature_blocks(layers: int) -> tuple[int, int, int]:
    """Return the blocks, from 0, whose features are low, middle and high: the first, the middle, the last (D5)."""
    return 0, (layers + 1) // 2 - 1, layers - 1


def resample(x: jax.Array, num_frames: int, fps: float) -> jax.Array:
    """Return the mean of features over each frame.

    The mean is over four points, each linear between the two nearest positions, so that every position of the window
    counts. Features at the middle of the frames alone would be aliased: a frame at 15 fps has 3.3 positions.

    Args:
        x: (B, positions, channels), 50 positions a second, the first at time 0.
        num_frames: number of frames of the result.
        fps: frames per second; the middle of frame n is at (n + 0.5) / fps.

    Returns:
        (B, num_frames, channels), values of the middle of each frame if the features are linear in time.

    Raises:
        ValueError: the middle of the last frame lies past the last position.
    """
    if frame_centres(num_frames, fps)[-1] * _POSITIONS_PER_SECOND >= x.shape[1] - 1:
        raise ValueError(
            f"{x.shape[1]} positions are {x.shape[1] / _POSITIONS_PER_SECOND:.2f} s; expected enough for {num_frames} "
            f"frames at {fps} fps, {num_frames / fps:.2f} s"
        )
    points = frame_centres(num_frames * _POINTS, fps * _POINTS) * _POSITIONS_PER_SECOND
    values = interpolate(x, points, axis=1)
    return values.reshape(len(x), num_frames, _POINTS, x.shape[-1]).mean(axis=2)


class AsrAudioEncoder(nn.Module):
    """Encoder of a window of Whisper's log-mel to low, middle and high features of each frame (D5).

    Whisper's own parameters are frozen: no gradient reaches them. What is trained is one linear map of each level. The
    features of a block are normalised over their channels, because a few channels of Whisper's residual stream are so
    much larger than the others that a linear map would see them alone.

    Attributes:
        whisper: the encoder, whose parameters come from `methods.whisper_weights`.
        feature_dim: number of values per frame and level.
        num_frames: frames of a window, N.
        fps: frames per second.
    """

    inputs = ("asr_mel",)

    whisper: WhisperEncoder
    feature_dim: int = 32
    num_frames: int = 34
    fps: float = 15

    @nn.compact
    def __call__(self, asr_mel: jax.Array, *, train: bool) -> Features:
        """Map the mel (B, num_mels, columns) of `asr_mel.asr_window` to features (B, N, feature_dim).

        Nothing here depends on `train`: Whisper has no dropout.
        """
        blocks = jax.lax.stop_gradient(self.whisper(asr_mel))
        levels = []
        for name, block in zip(Features._fields, feature_blocks(self.whisper.layers), strict=True):
            norm = nn.LayerNorm(epsilon=_EPSILON, use_bias=False, use_scale=False, use_fast_variance=False)
            x = resample(norm(blocks[block]), self.num_frames, self.fps)
            levels.append(nn.Dense(self.feature_dim, kernel_init=initializers.LINEAR, name=name)(x))
        return Features(*levels)
