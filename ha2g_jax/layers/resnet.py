"""ResNet of basic blocks (He et al. 2016) without the global average pool and the classifier. Channels last."""

import functools

import jax
from flax import linen as nn

from ha2g_jax.layers import recompute
from ha2g_jax.layers.conv import Conv
from ha2g_jax.layers.norm import BatchNorm


class ResNet(nn.Module):
    """Encoder of images to feature maps at 1/32 of their size, by default ResNet-18.

    Attributes:
        blocks: number of residual blocks of each stage.
        width: channels of the first stage, doubled at each following stage; 64 in the paper.
        is_recomputed: see `recompute.run`.
    """

    blocks: tuple[int, int, int, int] = (2, 2, 2, 2)
    width: int = 64
    is_recomputed: bool = False

    @nn.compact
    def __call__(self, images: jax.Array, *, train: bool) -> jax.Array:
        """Map images (B, S, S, 3) to features (B, S / 32, S / 32, 8 * width), sizes rounded up."""
        run = functools.partial(recompute.run, train=train, is_recomputed=self.is_recomputed)
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
        return nn.max_pool(x, (3, 3), strides=(2, 2), padding=((1, 1), (1, 1)))  # pyright: ignore[reportArgumentType]


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
