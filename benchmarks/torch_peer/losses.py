"""Terms of the objective (HA2G, Eq. 9) with PyTorch; the equations are in `ha2g_jax/methods/ha2g/losses.py`."""

import math

import torch
from torch.nn import functional as F

from ha2g_jax.skeleton import Skeleton

_RIGID_VARIANCE = (2 / 180) ** 2
_MIN_FEATURE_NORM = 1e-3
_MIN_STYLE_DISTANCE = 1e-5
_MIN_NORM = 1e-8
_MAX_COSINE = 1 - 1e-6


def huber(predictions: list[torch.Tensor], targets: list[torch.Tensor], delta: float) -> torch.Tensor:
    """Return the reconstruction loss (Eq. 5), the sum over levels of Huber's function divided by delta."""
    levels = [F.smooth_l1_loss(p, t, beta=delta) for p, t in zip(predictions, targets, strict=True)]
    return torch.stack(levels).sum()


class Physical(torch.nn.Module):
    """The physical constraint (Eq. 8) of poses (B, N, pose_dim), mean-subtracted, for one skeleton."""

    def __init__(self, skeleton: Skeleton):
        super().__init__()
        self.mean_directions = torch.tensor(skeleton.mean_directions)
        variance = torch.tensor(skeleton.angle_variance)
        is_moving = variance >= _RIGID_VARIANCE
        self.mean = torch.tensor(skeleton.angle_mean)[is_moving]
        self.variance = variance[is_moving]
        self.pairs = torch.tensor(skeleton.angle_pairs).T[:, is_moving]
        self.palms = torch.tensor(skeleton.palms).T if skeleton.palms else None
        self.normaliser = 0.5 * float(torch.log(2 * math.pi * self.variance).sum())

    def forward(self, poses: torch.Tensor) -> torch.Tensor:
        directions = _normalize(poses.unflatten(-1, self.mean_directions.shape) + self.mean_directions)
        if self.palms is not None:
            normals = torch.linalg.cross(directions[..., self.palms[0], :], directions[..., self.palms[1], :])
            directions = _normalize(torch.cat([directions, normals], dim=-2))
        first, second = (directions[..., bones, :] for bones in self.pairs)
        angles = (first * second).sum(-1).clamp(-_MAX_COSINE, _MAX_COSINE).acos() / math.pi
        return ((angles - self.mean) ** 2 / (2 * self.variance)).sum(-1).mean() + self.normaliser


def style(
    poses: torch.Tensor,
    other_poses: torch.Tensor,
    f_id: torch.Tensor,
    other_f_id: torch.Tensor,
    delta: float,
    clip: float,
) -> torch.Tensor:
    """Return the style diverging loss (Eq. 7); no gradient passes through `other_poses` and the styles."""
    distance = F.smooth_l1_loss(poses, other_poses.detach(), beta=delta, reduction="none").sum((1, 2))
    identity_distance = (f_id - other_f_id).abs().mean(-1).detach()
    return -(distance / (identity_distance + _MIN_STYLE_DISTANCE)).clamp(max=clip).mean()


def kld(mean: torch.Tensor, log_variance: torch.Tensor) -> torch.Tensor:
    """Return the KL divergence of the styles (B, 18) from N(0, I), the mean over the batch and the values."""
    return -0.5 * (1 + log_variance - mean**2 - log_variance.exp()).mean()


def contrastive(
    text: torch.Tensor, features: tuple[torch.Tensor, ...], temperature: float, negatives: tuple[str, ...]
) -> torch.Tensor:
    """Return the multi-level contrastive loss (Eq. 2), with all similarities in one matrix (B N, 3 B N)."""
    text, low, mid, high = (_unit(x.flatten(0, 1)) for x in (text, *features))
    levels = {"low": low, "mid": mid, "high": high}
    queries = text / temperature
    denominator = (queries @ torch.cat([levels[name] for name in negatives]).T).logsumexp(-1)
    positive = (queries * high).sum(-1)
    if "high" not in negatives:
        denominator = torch.logaddexp(denominator, positive)
    return (denominator - positive).mean()


def gan_generator(fake: torch.Tensor, kind: str) -> torch.Tensor:
    """Return the adversarial loss of the generator (Eq. 6) from logits (B,)."""
    if kind == "least_squares":
        return (1 - fake).square().mean()
    return F.softplus(-fake).mean() if kind == "non_saturating" else -F.softplus(fake).mean()


def gan_discriminator(real: torch.Tensor, fake: torch.Tensor, kind: str) -> torch.Tensor:
    """Return the adversarial loss of the discriminator from logits (B,) of true and generated poses."""
    if kind == "least_squares":
        return (1 - real).square().mean() + fake.square().mean()
    return F.softplus(-real).mean() + F.softplus(fake).mean()


def _normalize(vectors: torch.Tensor) -> torch.Tensor:
    return vectors / vectors.square().sum(-1, keepdim=True).clamp(min=_MIN_NORM**2).sqrt()


def _unit(vectors: torch.Tensor) -> torch.Tensor:
    return vectors * vectors.square().sum(-1, keepdim=True).clamp(min=_MIN_FEATURE_NORM**2).rsqrt()
