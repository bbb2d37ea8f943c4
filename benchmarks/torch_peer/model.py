"""HA2G with `torch.nn`: generator and discriminator of a spec of our package."""

import torch
from torch import nn
from torch.nn import functional as F

from ha2g_jax.layers import identity
from ha2g_jax.layers.resnet_se import Features
from ha2g_jax.methods import adversarial
from ha2g_jax.methods.method import Spec
from torch_peer.audio import AudioEncoder
from torch_peer.encoders import ImageIdentity, SpeakerIdentity, TextEncoder

_SLOPE = 0.2


def bi_gru(inputs: int, hidden_dim: int, layers: int, dropout: float) -> nn.GRU:
    """Return a bidirectional GRU; PyTorch warns of a dropout between the layers of a single one."""
    dropout = dropout if layers > 1 else 0.0
    return nn.GRU(inputs, hidden_dim, layers, batch_first=True, dropout=dropout, bidirectional=True)


def summed(gru: nn.GRU, x: torch.Tensor) -> torch.Tensor:
    """Return the sum of the two directions of a GRU on x (B, N, inputs), (B, N, hidden_dim)."""
    forward, backward = gru(x)[0].chunk(2, dim=-1)
    return forward + backward


class PoseStage(nn.Module):
    """One stage h of the pose inferer (Eq. 4): p^(h-1) in the channels of level h, f_a^h and the seed bit to p^h."""

    def __init__(self, feature_dim: int, pose_dim: int, ours):
        super().__init__()
        inputs = pose_dim + feature_dim
        self.gru = bi_gru(inputs + 1, ours.hidden_dim, ours.layers, ours.dropout)
        self.linear = nn.Linear(ours.hidden_dim + inputs, pose_dim)

    def forward(self, previous: torch.Tensor, audio: torch.Tensor, is_seed: torch.Tensor) -> torch.Tensor:
        hidden = summed(self.gru, torch.cat([previous, audio, is_seed], dim=-1))
        return self.linear(torch.cat([hidden, previous, audio], dim=-1))


class StyleCoordinator(nn.Module):
    """Map f_id (B, 18) to C (B, 3, H), whose columns over low, mid and high sum to 1."""

    def __init__(self, style_dim: int, num_levels: int, audio_levels: tuple[str, ...], *, is_tied: bool):
        super().__init__()
        self.num_levels, self.num_columns = num_levels, 1 if is_tied else num_levels
        self.linear = nn.Linear(style_dim, len(Features._fields) * self.num_columns)
        may_count = torch.tensor([name in audio_levels for name in Features._fields])
        self.register_buffer("may_count", may_count[None, :, None], persistent=False)

    def forward(self, f_id: torch.Tensor) -> torch.Tensor:
        scores = self.linear(f_id).unflatten(1, (len(Features._fields), self.num_columns))
        weights = scores.masked_fill(~self.may_count, -torch.inf).softmax(1)
        return weights.expand(-1, -1, self.num_levels)


class Generator(nn.Module):
    """The hierarchical audio learner and pose inferer, with the sizes of a spec's generator."""

    def __init__(self, spec: Spec):
        super().__init__()
        ours = spec.generator
        self.level_channels = [torch.tensor(channels) for channels in ours.level_channels]
        self.places = [
            torch.tensor([channels.index(channel) for channel in below])
            for below, channels in zip(ours.level_channels, ours.level_channels[1:], strict=False)
        ]
        self.num_frames, self.num_seed_frames = spec.num_frames, spec.num_seed_frames
        self.audio, self.text = AudioEncoder(ours.audio), TextEncoder(ours.text)
        if isinstance(ours.identity, identity.SpeakerIdentity):
            self.identity = SpeakerIdentity(ours.identity)
        else:
            self.identity = ImageIdentity(ours.identity, spec.image_size)
        num_levels = len(ours.level_channels)
        self.coordinator = StyleCoordinator(spec.style_dim, num_levels, ours.audio_levels, is_tied=ours.is_tied)
        dims = [len(channels) for channels in ours.level_channels]
        for level, dim in enumerate(dims, 1):
            self.add_module(f"pose_{level}", PoseStage(ours.audio.feature_dim, dim, ours))

    def encode(self, mel: torch.Tensor, words: torch.Tensor, who: torch.Tensor):
        """Return the audio features, the text features and (mean, log-variance) of the identities."""
        return self.audio(mel), self.text(words), self.identity(who)

    def infer(self, features, f_id: torch.Tensor, seed: torch.Tensor) -> list[torch.Tensor]:
        """Run the cascade of stages, coarse to fine (Eq. 3 and 4).

        Args:
            features: f_low, f_mid and f_high, each (B, N, 32).
            f_id: (B, 18) identity.
            seed: (B, M, pose_dim) true poses of the first M frames, mean-subtracted.

        Returns:
            Per level (B, N, d^h), mean-subtracted.
        """
        blended = torch.einsum("blh,blnf->hbnf", self.coordinator(f_id), torch.stack(features, 1))
        batch, free_frames = len(seed), self.num_frames - self.num_seed_frames
        is_seed = seed.new_zeros(batch, self.num_frames, 1)
        is_seed[:, : self.num_seed_frames] = 1
        poses: list[torch.Tensor] = []
        for level in range(len(self.level_channels)):
            known = seed[..., self.level_channels[level]]
            free = seed.new_zeros(batch, free_frames, known.shape[-1])
            if level:
                free = free.index_copy(-1, self.places[level - 1], poses[-1][:, self.num_seed_frames :])
            stage = self.get_submodule(f"pose_{level + 1}")
            poses.append(stage(torch.cat([known, free], 1), blended[level], is_seed))
        return poses


class Discriminator(nn.Module):
    """Map poses (B, N, pose_dim) to logits (B,) (HA2G, Table 8)."""

    def __init__(self, ours: adversarial.Discriminator, spec: Spec):
        super().__init__()
        self.conv_1, self.norm_1 = nn.Conv1d(spec.skeleton.pose_dim, 16, 3), nn.BatchNorm1d(16)
        self.conv_2, self.norm_2 = nn.Conv1d(16, 8, 3), nn.BatchNorm1d(8)
        self.conv_3 = nn.Conv1d(8, 8, 3)
        self.gru = bi_gru(8, ours.hidden_dim, ours.layers, ours.dropout)
        self.linear_1 = nn.Linear(ours.hidden_dim, 1)
        self.linear_2 = nn.Linear(spec.num_frames - 6, 1)

    def forward(self, poses: torch.Tensor) -> torch.Tensor:
        x = F.leaky_relu(self.norm_1(self.conv_1(poses.transpose(1, 2))), _SLOPE)
        x = F.leaky_relu(self.norm_2(self.conv_2(x)), _SLOPE)
        x = summed(self.gru, self.conv_3(x).transpose(1, 2))
        return self.linear_2(self.linear_1(x)[..., 0])[..., 0]
