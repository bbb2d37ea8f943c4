"""Speaker identity encoders E_ID: mean and log-variance of f_id, from images or from a table of speakers."""

import jax
import jax.numpy as jnp
from flax import linen as nn

from ha2g_jax.layers import initializers
from ha2g_jax.layers.resnet import ResNet


class ImageIdentity(nn.Module):
    """Encoder of reference images to the distribution of f_id (HA2G, supplement B).

    Decision D6: one ResNet-18 encodes all M images; the feature maps are averaged, flattened and mapped linearly.

    Attributes:
        blocks: number of residual blocks of each stage of the ResNet; those of ResNet-18 in the paper.
        width: channels of the first stage of the ResNet.
        feature_dim: number of values of f_id.
        is_recomputed: see `recompute.run`.
    """

    blocks: tuple[int, int, int, int] = (2, 2, 2, 2)
    width: int = 64
    feature_dim: int = 18
    is_recomputed: bool = False

    @nn.compact
    def __call__(self, images: jax.Array, *, train: bool) -> tuple[jax.Array, jax.Array]:
        """Map RGB images (B, M, S, S, 3) of values 0 to 255 to mean and log-variance, each (B, feature_dim)."""
        batch, count = images.shape[:2]
        flat = images.reshape(batch * count, *images.shape[2:]) / 127.5 - 1  # float32 for images of uint8
        x = ResNet(self.blocks, self.width, self.is_recomputed, name="resnet")(flat, train=train)
        x = jnp.mean(x.reshape(batch, count, *x.shape[1:]), axis=1)
        # Channels first, as PyTorch flattens (C, H, W).
        return _heads(x.transpose(0, 3, 1, 2).reshape(batch, -1), self.feature_dim)


class SpeakerIdentity(nn.Module):
    """Table of speakers with the outputs of `ImageIdentity`, for data sets without images.

    Attributes:
        num_speakers: number of rows of the table.
        feature_dim: number of values of f_id.
        has_hidden: whether there is a linear map between the table and the two heads, as in Trimodal.
    """

    num_speakers: int
    feature_dim: int = 18
    has_hidden: bool = False

    @nn.compact
    def __call__(self, speaker: jax.Array, *, train: bool) -> tuple[jax.Array, jax.Array]:
        """Map speaker indices (B,) to mean and log-variance, each (B, feature_dim)."""
        del train  # the argument exists because `ImageIdentity` has it
        normal = initializers.normal(1.0)
        # The gradients of the rows are summed over the batch in float32.
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
