"""Audio encoder E_a: ResNetSE-34 with three heads (HA2G, Tables 6 and 7). Channels last."""

import functools
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import linen as nn

from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.features.spectrum import HOP_LENGTH, window_columns
from ha2g_jax.layers.conv import BatchNorm, Conv, run_block
from ha2g_jax.layers.linear import Linear
from ha2g_jax.layers.resampling import frame_centres, interpolate

_REDUCTION = 8
MEL_RANGE = 80.0
# Factor of the pixel shuffle and size of the kernel of each head; after the shuffle all maps have half as many columns
# as the mel.
HEADS = {"low": (1, 2), "mid": (2, 3), "high": (4, 3)}
_COLUMNS_PER_SECOND = SAMPLE_RATE / HOP_LENGTH / 2


class Features(NamedTuple):
    """Audio features of the three levels, each (B, N, feature_dim)."""

    low: jax.Array
    mid: jax.Array
    high: jax.Array


def pixel_shuffle(x: jax.Array, factor: int) -> jax.Array:
    """Move channels (B, H, W, C factor^2) into space (B, factor H, factor W, C), as in Shi et al. 2016 and PyTorch.

    Row factor i + a, column factor j + b of output channel c comes from input channel c factor^2 + a factor + b.
    """
    batch, height, width, channels = x.shape
    x = x.reshape(batch, height, width, channels // factor**2, factor, factor)
    x = x.transpose(0, 1, 4, 2, 5, 3)
    return x.reshape(batch, height * factor, width * factor, channels // factor**2)


def head_grid(widths: Sequence[int], num_frames: int, fps: float) -> tuple[int, float] | None:
    """Return (N, fps) if the columns of the heads have to be interpolated, None if they give N frames as they are.

    The widths are the columns of the maps of low, mid and high, before the pixel shuffle.
    """
    frames = {factor * width - kernel + 1 for width, (factor, kernel) in zip(widths, HEADS.values(), strict=True)}
    return None if frames == {num_frames} else (num_frames, fps)


def head_places(kernel: int, num_frames: int, fps: float) -> np.ndarray:
    """Return the columns (N + kernel - 1,), as fractions, at which a head takes its map after the pixel shuffle.

    The convolution of the head, `kernel` wide, is centred on the middle of each frame.
    """
    return frame_centres(num_frames + kernel - 1, fps, margin=(kernel - 1) / 2) * _COLUMNS_PER_SECOND


class SqueezeExcite(nn.Module):
    """Scale each channel by a gate computed from the channels' means (Hu et al. 2018), reduction 8."""

    @nn.compact
    def __call__(self, x: jax.Array) -> jax.Array:
        """Map (B, H, W, C) to the same shape."""
        channels = x.shape[-1]
        gate = jnp.mean(x, axis=(1, 2))
        gate = nn.relu(Linear(channels // _REDUCTION, name="squeeze")(gate))
        gate = nn.sigmoid(Linear(channels, name="excite")(gate))
        return x * gate[:, None, None]


class BasicBlock(nn.Module):
    """conv, ReLU, BN, conv, BN, SE, add, ReLU; the shortcut is a 1x1 conv and BN where the shape changes."""

    channels: int
    stride: int = 1

    @nn.compact
    def __call__(self, x: jax.Array, *, train: bool) -> jax.Array:
        """Map (B, H, W, C) to (B, H / stride, W / stride, channels), rounded up."""
        strides = (self.stride, self.stride)
        y = Conv(self.channels, (3, 3), strides, 1, use_bias=False, name="conv_1")(x)
        y = BatchNorm(name="norm_1")(nn.relu(y), train=train)
        y = Conv(self.channels, (3, 3), padding=1, use_bias=False, name="conv_2")(y)
        y = BatchNorm(name="norm_2")(y, train=train)
        y = SqueezeExcite(name="se")(y)
        if self.stride != 1 or x.shape[-1] != self.channels:
            x = Conv(self.channels, (1, 1), strides, use_bias=False, name="shortcut_conv")(x)
            x = BatchNorm(name="shortcut_norm")(x, train=train)
        return nn.relu(x + y)


class Stage(nn.Module):
    """A sequence of basic blocks, the first of which may have a stride."""

    blocks: int
    channels: int
    stride: int
    is_recomputed: bool = False

    @nn.compact
    def __call__(self, x: jax.Array, *, train: bool) -> jax.Array:
        """Map (B, H, W, C) to (B, H / stride, W / stride, channels), rounded up."""
        for index in range(self.blocks):
            stride = self.stride if index == 0 else 1
            block = BasicBlock(self.channels, stride, name=f"block_{index}")
            x = run_block(block, x, train=train, is_recomputed=self.is_recomputed)
        return x


class Stem(nn.Module):
    """3x3 convolution, ReLU, BN, in this order."""

    channels: int
    stride: tuple[int, int]

    @nn.compact
    def __call__(self, x: jax.Array, *, train: bool) -> jax.Array:
        """Map (B, H, W, 1) to (B, H / stride, W / stride, channels), rounded up."""
        x = Conv(self.channels, (3, 3), self.stride, 1, name="conv")(x)
        return BatchNorm(name="norm")(nn.relu(x), train=train)


class Head(nn.Module):
    """Head from a feature map to one feature per frame (Table 7): PixelShuffle, conv, ReLU, BN, reshape, FC.

    Attributes:
        shuffle: factor of the pixel shuffle, 1 for none.
        kernel: height and width of the unpadded convolution.
        grid: (N, fps) if the columns are first interpolated so that the convolution is centred on the middle of each
            frame; None if there already are N + kernel - 1 columns, as in the paper.
    """

    shuffle: int
    kernel: int
    feature_dim: int
    grid: tuple[int, float] | None = None

    @nn.compact
    def __call__(self, x: jax.Array, *, train: bool) -> jax.Array:
        """Map (B, mel, columns, C) to (B, N, feature_dim)."""
        x = pixel_shuffle(x, self.shuffle)
        if self.grid is not None:
            x = interpolate(x, head_places(self.kernel, *self.grid), axis=2)
        x = Conv(x.shape[-1], (self.kernel, self.kernel), name="conv")(x)
        x = BatchNorm(name="norm")(nn.relu(x), train=train)
        # Channel-major, as a reshape of PyTorch's (C, mel, N) merges them.
        x = x.transpose(0, 2, 3, 1).reshape(x.shape[0], x.shape[2], -1)
        return Linear(self.feature_dim, name="linear")(x)


class AudioEncoder(nn.Module):
    """Encoder of a log-mel window to low, middle and high features of each frame.

    At the paper's size a 1 x 128 x 70 window gives 64 x 64 x 35 (stage 2, low), 128 x 32 x 18 (stage 3, middle)
    and 256 x 16 x 9 (stage 4, high), each turned into 32 x 34. If the columns of a window do not give N frames this
    way, because of its length or frame rate, the columns of each head are interpolated, see `Head`.

    Attributes:
        blocks, channels: number of blocks and of channels of each stage.
        stem_stride: stride of the stem along mel and time; the stride in time must be 1.
        is_recomputed: see `conv.run_block`.
        reads_decibels: whether the network reads dB, as in the release, instead of dB / 80 + 1 (D3).
    """

    blocks: tuple[int, int, int, int] = (3, 4, 6, 3)
    channels: tuple[int, int, int, int] = (32, 64, 128, 256)
    stem_stride: tuple[int, int] = (1, 1)
    feature_dim: int = 32
    num_frames: int = 34
    fps: float = 15
    is_recomputed: bool = False
    reads_decibels: bool = False

    inputs = ("mel",)

    @nn.compact
    def __call__(self, mel: jax.Array, *, train: bool) -> Features:
        """Map the mel (B, 128, columns) of a window in dB, -80 to 0, to features (B, N, feature_dim).

        Raises:
            ValueError: the mel is not as long as N frames.
        """
        expected = window_columns(self.num_frames, self.fps)
        if mel.shape[-1] != expected:
            raise ValueError(
                f"a mel of {mel.shape[-1]} columns; expected {expected} for {self.num_frames} frames at {self.fps} fps"
            )
        x = (mel if self.reads_decibels else mel / MEL_RANGE + 1)[..., None]  # D3
        run = functools.partial(run_block, train=train, is_recomputed=self.is_recomputed)
        x = run(Stem(self.channels[0], self.stem_stride, name="stem"), x)
        maps = []
        for index, (blocks, channels) in enumerate(zip(self.blocks, self.channels, strict=True)):
            stage = Stage(blocks, channels, 2 if index else 1, self.is_recomputed, name=f"stage_{index + 1}")
            maps.append(x := stage(x, train=train))
        grid = head_grid([level.shape[2] for level in maps[1:]], self.num_frames, self.fps)
        heads = {
            name: run(Head(factor, kernel, self.feature_dim, grid, name=name), level)
            for level, (name, (factor, kernel)) in zip(maps[1:], HEADS.items())
        }
        return Features(**heads)
