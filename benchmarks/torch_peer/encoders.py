"""Encoders of the words (TCN) and of the identity (table of speakers, or ResNet-18 on images) with `torch.nn`."""

import torch
from torch import nn
from torch.nn import functional as F
from torch.nn.utils import parametrizations

from ha2g_jax.layers import identity, tcn

_EMBEDDING_DROPOUT = 0.1


class TextBlock(nn.Module):
    """[convolution, ReLU, dropout] once or twice, added to the input, then ReLU; maps (B, inputs, N)."""

    def __init__(self, inputs: int, channels: int, dilation: int, dropout: float, *, is_centred: bool):
        super().__init__()
        self.padding = (dilation - dilation // 2, dilation // 2) if is_centred else (dilation, 0)
        self.count, self.dropout = (1 if is_centred else 2), nn.Dropout(dropout)
        for index in range(self.count):
            conv = nn.Conv1d(channels if index else inputs, channels, 2, dilation=dilation)
            self.add_module(f"conv_{index}", parametrizations.weight_norm(conv))
        self.shortcut = nn.Conv1d(inputs, channels, 1) if inputs != channels else nn.Identity()

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        y = x
        for index in range(self.count):
            y = self.dropout(F.relu(self.get_submodule(f"conv_{index}")(F.pad(y, self.padding))))
        return F.relu(self.shortcut(x) + y)


class TextEncoder(nn.Module):
    """Map word indices (B, N) to features (B, N, feature_dim), with the sizes of our encoder."""

    def __init__(self, ours: tcn.TextEncoder):
        super().__init__()
        self.embedding = nn.Embedding(ours.vocabulary_size, ours.embedding_dim)
        self.dropout = nn.Dropout(_EMBEDDING_DROPOUT if ours.dropout else 0.0)
        inputs, is_centred = ours.embedding_dim, ours.receptive_field == "centred"
        self.num_blocks = ours.layers
        for index in range(ours.layers):
            block = TextBlock(inputs, ours.channels, 2**index, ours.dropout, is_centred=is_centred)
            self.add_module(f"block_{index}", block)
            inputs = ours.channels
        self.linear = nn.Linear(inputs, ours.feature_dim)

    def forward(self, words: torch.Tensor) -> torch.Tensor:
        x = self.dropout(self.embedding(words)).transpose(1, 2)
        for index in range(self.num_blocks):
            x = self.get_submodule(f"block_{index}")(x)
        return self.linear(x.transpose(1, 2))


class SpeakerIdentity(nn.Module):
    """Map speaker indices (B,) to mean and log-variance of f_id, each (B, feature_dim)."""

    def __init__(self, ours: identity.SpeakerIdentity):
        super().__init__()
        self.embedding = nn.Embedding(ours.num_speakers, ours.feature_dim)
        self.mean = nn.Linear(ours.feature_dim, ours.feature_dim)
        self.log_variance = nn.Linear(ours.feature_dim, ours.feature_dim)

    def forward(self, speaker: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        x = self.embedding(speaker)
        return self.mean(x), self.log_variance(x)


class ResidualBlock(nn.Module):
    """conv, BN, ReLU, conv, BN, add, ReLU; the shortcut is a 1x1 conv and BN where the shape changes."""

    def __init__(self, inputs: int, channels: int, stride: int):
        super().__init__()
        self.conv_1 = nn.Conv2d(inputs, channels, 3, stride, 1, bias=False)
        self.norm_1 = nn.BatchNorm2d(channels)
        self.conv_2 = nn.Conv2d(channels, channels, 3, 1, 1, bias=False)
        self.norm_2 = nn.BatchNorm2d(channels)
        self.has_shortcut = stride != 1 or inputs != channels
        if self.has_shortcut:
            self.shortcut_conv = nn.Conv2d(inputs, channels, 1, stride, bias=False)
            self.shortcut_norm = nn.BatchNorm2d(channels)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        y = self.norm_2(self.conv_2(F.relu(self.norm_1(self.conv_1(x)))))
        if self.has_shortcut:
            x = self.shortcut_norm(self.shortcut_conv(x))
        return F.relu(x + y)


class ResNet(nn.Module):
    """Map images (B, 3, S, S) to features (B, 8 width, S / 32, S / 32)."""

    def __init__(self, blocks: tuple[int, ...], width: int):
        super().__init__()
        self.conv = nn.Conv2d(3, width, 7, 2, 3, bias=False)
        self.norm = nn.BatchNorm2d(width)
        self.names, inputs = [], width
        for stage, count in enumerate(blocks):
            for block in range(count):
                channels, stride = width * 2**stage, 2 if stage and not block else 1
                self.names.append(f"stage_{stage + 1}_block_{block}")
                self.add_module(self.names[-1], ResidualBlock(inputs, channels, stride))
                inputs = channels

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        x = F.max_pool2d(F.relu(self.norm(self.conv(x))), 3, 2, 1)
        for name in self.names:
            x = self.get_submodule(name)(x)
        return x


class ImageIdentity(nn.Module):
    """Map images (B, M, S, S, 3) of bytes to mean and log-variance of f_id, each (B, feature_dim)."""

    def __init__(self, ours: identity.ImageIdentity, image_size: int):
        super().__init__()
        self.resnet = ResNet(ours.blocks, ours.width)
        values = ours.width * 2 ** (len(ours.blocks) - 1) * (-(-image_size // 32)) ** 2
        self.mean = nn.Linear(values, ours.feature_dim)
        self.log_variance = nn.Linear(values, ours.feature_dim)

    def forward(self, images: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        batch, count = images.shape[:2]
        x = self.resnet((images.flatten(0, 1) / 127.5 - 1).permute(0, 3, 1, 2))
        x = x.unflatten(0, (batch, count)).mean(1).flatten(1)
        return self.mean(x), self.log_variance(x)
