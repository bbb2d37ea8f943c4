"""Audio encoder E_a: ResNetSE-34 with three heads (HA2G, Tables 6 and 7). Channels first, as PyTorch has them."""

import torch
from torch import nn
from torch.nn import functional as F

from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.features.spectrum import HOP_LENGTH, NUM_MELS, window_columns
from ha2g_jax.layers import resnet_se
from ha2g_jax.layers.resampling import frame_centres
from torch_peer.encoders import ResidualBlock

_REDUCTION = 8
_MEL_RANGE = 80.0
_HEADS = {"low": (1, 2), "mid": (2, 3), "high": (4, 3)}  # factor of the pixel shuffle and size of the kernel
_COLUMNS_PER_SECOND = SAMPLE_RATE / HOP_LENGTH / 2


class SqueezeExcite(nn.Module):
    def __init__(self, channels: int):
        super().__init__()
        self.squeeze = nn.Linear(channels, channels // _REDUCTION)
        self.excite = nn.Linear(channels // _REDUCTION, channels)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        gate = torch.sigmoid(self.excite(F.relu(self.squeeze(x.mean((2, 3))))))
        return x * gate[:, :, None, None]


class BasicBlock(ResidualBlock):
    """conv, ReLU, BN, conv, BN, SE, add, ReLU; the shortcut is a 1x1 conv and BN where the shape changes."""

    def __init__(self, inputs: int, channels: int, stride: int):
        super().__init__(inputs, channels, stride)
        self.se = SqueezeExcite(channels)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        y = self.norm_1(F.relu(self.conv_1(x)))
        y = self.se(self.norm_2(self.conv_2(y)))
        if self.has_shortcut:
            x = self.shortcut_norm(self.shortcut_conv(x))
        return F.relu(x + y)


class Stem(nn.Module):
    def __init__(self, channels: int, stride: tuple[int, int]):
        super().__init__()
        self.conv = nn.Conv2d(1, channels, 3, stride, 1)
        self.norm = nn.BatchNorm2d(channels)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return self.norm(F.relu(self.conv(x)))


class Head(nn.Module):
    """PixelShuffle, conv, ReLU, BN, reshape, linear map (Table 7); see `ha2g_jax.layers.resnet_se.Head`.

    Args:
        shape: channels and rows of the map.
        shuffle: factor of the pixel shuffle.
        kernel: height and width of the convolution.
        feature_dim: number of values per frame.
        grid: (N, fps) where the columns are interpolated, else None.
    """

    def __init__(
        self, shape: tuple[int, int], shuffle: int, kernel: int, feature_dim: int, grid: tuple[int, float] | None
    ):
        super().__init__()
        channels, rows = shape[0] // shuffle**2, shape[1] * shuffle
        self.shuffle, self.places = shuffle, None
        if grid is not None:
            times = frame_centres(grid[0] + kernel - 1, grid[1], margin=(kernel - 1) / 2)
            self.places = torch.tensor(times * _COLUMNS_PER_SECOND, dtype=torch.float32)
        self.conv = nn.Conv2d(channels, channels, kernel)
        self.norm = nn.BatchNorm2d(channels)
        self.linear = nn.Linear(channels * (rows - kernel + 1), feature_dim)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        x = F.pixel_shuffle(x, self.shuffle)
        if self.places is not None:
            last = x.shape[3] - 1
            places = self.places.clamp(0, last)
            before = places.floor().long().clamp(max=last - 1)
            weight = places - before
            x = x[..., before] * (1 - weight) + x[..., before + 1] * weight
        x = self.norm(F.relu(self.conv(x)))
        return self.linear(x.permute(0, 3, 1, 2).flatten(2))


class AudioEncoder(nn.Module):
    """Map the mel (B, 128, columns) of windows in dB to f_low, f_mid and f_high, each (B, N, feature_dim).

    Args:
        ours: encoder of our package, whose sizes this one has.
    """

    def __init__(self, ours: resnet_se.AudioEncoder):
        super().__init__()
        self.stem = Stem(ours.channels[0], ours.stem_stride)
        rows, columns = NUM_MELS, window_columns(ours.num_frames, ours.fps)
        rows, columns = (-(-size // stride) for size, stride in zip((rows, columns), ours.stem_stride))
        inputs, shapes, widths = ours.channels[0], [], []
        for index, (blocks, channels) in enumerate(zip(ours.blocks, ours.channels, strict=True)):
            stride = 2 if index else 1
            rows, columns = -(-rows // stride), -(-columns // stride)
            stage = nn.Sequential()
            for block in range(blocks):
                stage.add_module(f"block_{block}", BasicBlock(inputs, channels, 1 if block else stride))
                inputs = channels
            self.add_module(f"stage_{index + 1}", stage)
            shapes.append((channels, rows))
            widths.append(columns)
        frames = {shuffle * width - kernel + 1 for width, (shuffle, kernel) in zip(widths[1:], _HEADS.values())}
        grid = None if frames == {ours.num_frames} else (ours.num_frames, ours.fps)
        for (name, (shuffle, kernel)), shape in zip(_HEADS.items(), shapes[1:], strict=True):
            self.add_module(name, Head(shape, shuffle, kernel, ours.feature_dim, grid))

    def forward(self, mel: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        x = self.stage_1(self.stem((mel / _MEL_RANGE + 1)[:, None]))
        low = self.stage_2(x)
        mid = self.stage_3(low)
        return self.low(low), self.mid(mid), self.high(self.stage_4(mid))
