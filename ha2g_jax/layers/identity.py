"""Speaker identity encoders E_ID: mean and log-variance of f_id, from images by ResNet-18 or from a table."""

import functools

import jax
import jax.numpy as jnp
from flax import linen as nn

from ha2g_jax.layers import initializers
from ha2g_jax.layers.conv import BatchNorm, Conv, run_block
from ha2g_jax.layers.linear import Embedding, Linear, mean_and_log_variance


class ImageIdentity(nn.Module):
    """Encoder of reference images to the distribution of f_id (HA2G, supplement B).

    Decision D6: one ResNet-18 encodes all M images; the feature maps are averaged, flattened and mapped linearly.

    Attributes:
        blocks, width, is_recomputed: attributes of the `ResNet`.
        feature_dim: number of values of f_id.
    """

    blocks: tuple[int, int, int, int] = (2, 2, 2, 2)
    width: int = 64
    feature_dim: int = 18
    is_recomputed: bool = False

    @nn.compact
    def __call__(self, images: jax.Array, *, train: bool) -> tuple[jax.Array, jax.Array]:
        """Map RGB images (B, M, S, S, 3) of values 0 to 255 to mean and log-variance, each (B, feature_dim)."""
        batch, count = images.shape[:2]
        dtype = images.dtype if jnp.issubdtype(images.dtype, jnp.floating) else jnp.float32
        flat = images.reshape(batch * count, *images.shape[2:]).astype(dtype) / 127.5 - 1
        x = ResNet(self.blocks, self.width, self.is_recomputed, name="resnet")(flat, train=train)
        x = jnp.mean(x.reshape(batch, count, *x.shape[1:]), axis=1)
        # Channels first, as PyTorch flattens (C, H, W).
        return mean_and_log_variance(x.transpose(0, 3, 1, 2).reshape(batch, -1), self.feature_dim)


class SpeakerIdentity(nn.Module):
    """Table of speakers with the outputs of `ImageIdentity`, for data sets without images.

    Attributes:
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
        x = Embedding(self.num_speakers, self.feature_dim, embedding_init=normal, name="embedding")(speaker)
        if self.has_hidden:
            x = Linear(self.feature_dim, name="linear")(x)
        return mean_and_log_variance(x, self.feature_dim)


class ResNet(nn.Module):
    """ResNet of basic blocks (He et al. 2016) without the global average pool and the classifier, by default ResNet-18.

    Attributes:
        blocks: number of residual blocks of each stage.
        width: channels of the first stage, doubled at each following stage; 64 in the paper.
        is_recomputed: see `conv.run_block`.
    """

    blocks: tuple[int, int, int, int] = (2, 2, 2, 2)
    width: int = 64
    is_recomputed: bool = False

    @nn.compact
    def __call__(self, images: jax.Array, *, train: bool) -> jax.Array:
        """Map images (B, S, S, 3) to features (B, S / 32, S / 32, 8 * width), sizes rounded up."""
        run = functools.partial(run_block, train=train, is_recomputed=self.is_recomputed)
        x = run(self, images, method="_stem")
        for stage, blocks in enumerate(self.blocks):
            for block in range(blocks):
                stride = 2 if stage and not block else 1
                name = f"stage_{stage + 1}_block_{block}"
                x = run(ResidualBlock(self.width * 2**stage, stride, name=name), x)
        return x

    def _stem(self, images: jax.Array, *, train: bool) -> jax.Array:
        x = Conv(self.width, (7, 7), (2, 2), 3, use_bias=False, name="conv")(images)
        x = nn.relu(BatchNorm(name="norm")(x, train=train))
        # Flax declares the padding as a string but also accepts pairs.
        return nn.max_pool(x, (3, 3), strides=(2, 2), padding=((1, 1), (1, 1)))


class ResidualBlock(nn.Module):
    """Residual block: conv, BN, ReLU, conv, BN, add, ReLU; the shortcut is a 1x1 conv and BN if the shape changes."""

    channels: int
    stride: int

    @nn.compact
    def __call__(self, x: jax.Array, *, train: bool) -> jax.Array:
        """Map (B, H, W, C) to (B, H / stride, W / stride, channels), rounded up."""
        strides = (self.stride, self.stride)
        y = Conv(self.channels, (3, 3), strides, 1, use_bias=False, name="conv_1")(x)
        y = nn.relu(BatchNorm(name="norm_1")(y, train=train))
        y = Conv(self.channels, (3, 3), padding=1, use_bias=False, name="conv_2")(y)
        y = BatchNorm(name="norm_2")(y, train=train)
        if self.stride != 1 or x.shape[-1] != self.channels:
            x = Conv(self.channels, (1, 1), strides, use_bias=False, name="shortcut_conv")(x)
            x = BatchNorm(name="shortcut_norm")(x, train=train)
        return nn.relu(x + y)
