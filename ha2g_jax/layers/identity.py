"""Speaker identity encoders E_ID: mean and log-variance of f_id, from images or from a table of speakers."""

import jax
import jax.numpy as jnp
from flax import linen as nn

from ha2g_jax.layers import initializers
from ha2g_jax.layers.resnet import ResNet18


class ImageIdentity(nn.Module):
    """Reference frames to the distribution of f_id (HA2G, supplement B).

    Decision D6: one ResNet-18 for the M frames, whose feature maps are averaged, flattened and mapped linearly.

    Attributes:
        width: channels of the ResNet's first stage.
        feature_dim: values of f_id.
        is_recomputed: see `recompute.run`.
    """

    width: int = 64
    feature_dim: int = 18
    is_recomputed: bool = False

    @nn.compact
    def __call__(self, frames: jax.Array, *, train: bool) -> tuple[jax.Array, jax.Array]:
        """Maps RGB images (B, M, S, S, 3) of values 0 to 255 to mean and log-variance, each (B, feature_dim)."""
        batch, count = frames.shape[:2]
        images = frames.reshape(batch * count, *frames.shape[2:]) / 127.5 - 1  # float32 where frames are uint8
        x = ResNet18(self.width, self.is_recomputed, name="resnet")(images, train=train)
        x = jnp.mean(x.reshape(batch, count, *x.shape[1:]), axis=1)
        # Channel-major, as PyTorch flattens (C, H, W).
        return _heads(x.transpose(0, 3, 1, 2).reshape(batch, -1), self.feature_dim)


class SpeakerIdentity(nn.Module):
    """A table of speakers with the outputs of `ImageIdentity`, for data sets without images.

    Attributes:
        num_speakers: rows of the table.
        feature_dim: values of f_id.
        has_hidden: whether a linear map lies between the table and the two heads, as in Trimodal.
    """

    num_speakers: int
    feature_dim: int = 18
    has_hidden: bool = False

    @nn.compact
    def __call__(self, speaker: jax.Array, *, train: bool) -> tuple[jax.Array, jax.Array]:
        """Maps speaker indices (B,) to mean and log-variance, each (B, feature_dim)."""
        del train  # The table has no training behaviour; the argument is that of `ImageIdentity`.
        normal = nn.initializers.normal(1.0)
        # The rows' gradients are summed over the batch in float32.
        table = nn.Embed(
            self.num_speakers, self.feature_dim, dtype=jnp.float32, embedding_init=normal, name="embedding"
        )
        x = table(speaker).astype(table.embedding.dtype)
        if self.has_hidden:
            x = nn.Dense(self.feature_dim, kernel_init=initializers.LINEAR, name="linear")(x)
        return _heads(x, self.feature_dim)


def _heads(x: jax.Array, feature_dim: int) -> tuple[jax.Array, jax.Array]:
    mean = nn.Dense(feature_dim, kernel_init=initializers.LINEAR, name="mean")(x)
    log_variance = nn.Dense(feature_dim, kernel_init=initializers.LINEAR, name="log_variance")(x)
    return mean, log_variance
