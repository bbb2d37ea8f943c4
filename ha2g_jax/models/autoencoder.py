"""Pose auto-encoder whose latent space measures the Frechet gesture distance (HA2G, Table 9)."""

import jax
from flax import linen as nn

from ha2g_jax.models import initializers
from ha2g_jax.models.norm import BatchNorm

# Values of the latent per skeleton: Table 9, and Yoon et al. 2020 for TED-Gesture.
LATENT_DIMS = {"ted_expressive": 128, "ted_gesture": 32}

_SLOPE = 0.2
_NUM_FRAMES = 34  # the decoder's linear map has this many frames built in


class PoseEncoder(nn.Module):
    """Poses (B, 34, pose_dim) to a latent (B, latent_dim)."""

    latent_dim: int

    @nn.compact
    def __call__(self, poses: jax.Array, *, train: bool) -> jax.Array:
        x = _conv(32, 3, 1, name="conv_1")(poses)
        x = _conv(64, 3, 1, name="conv_2")(_activate(x, "norm_1", train))
        x = _conv(64, 4, 2, name="conv_3")(_activate(x, "norm_2", train))
        x = _conv(32, 3, 1, name="conv_4")(_activate(x, "norm_3", train))
        x = x.transpose(0, 2, 1).reshape(x.shape[0], -1)  # channel-major, as PyTorch flattens (C, N)
        x = _activate(_linear(256, name="linear_1")(x), "norm_4", train)
        x = _activate(_linear(128, name="linear_2")(x), "norm_5", train)
        return _linear(self.latent_dim, name="linear_3")(x)


class PoseDecoder(nn.Module):
    """Latent (B, latent_dim) to poses (B, 34, pose_dim)."""

    pose_dim: int

    @nn.compact
    def __call__(self, latent: jax.Array, *, train: bool) -> jax.Array:
        x = _activate(_linear(64, name="linear_1")(latent), "norm_1", train)
        x = _linear(4 * _NUM_FRAMES, name="linear_2")(x)
        x = x.reshape(x.shape[0], 4, _NUM_FRAMES).transpose(0, 2, 1)
        x = _activate(_transposed_conv(32, name="conv_1")(x), "norm_2", train)
        x = _activate(_transposed_conv(32, name="conv_2")(x), "norm_3", train)
        x = _conv(32, 3, 1, name="conv_3")(x)
        return _conv(self.pose_dim, 3, 1, name="conv_4")(x)


class PoseAutoencoder(nn.Module):
    """Windows of poses to a latent and back. `encode` and `decode` can be the `method=` of `apply`.

    Attributes:
        pose_dim: values of a flat pose.
        latent_dim: values of the latent, see LATENT_DIMS.
    """

    pose_dim: int
    latent_dim: int

    def setup(self) -> None:
        self.encoder = PoseEncoder(self.latent_dim)
        self.decoder = PoseDecoder(self.pose_dim)

    def __call__(self, poses: jax.Array, *, train: bool) -> jax.Array:
        """Maps mean-subtracted poses (B, 34, pose_dim) to their reconstruction."""
        return self.decode(self.encode(poses, train=train), train=train)

    def encode(self, poses: jax.Array, *, train: bool) -> jax.Array:
        """Maps mean-subtracted poses (B, 34, pose_dim) to latents (B, latent_dim)."""
        return self.encoder(poses, train=train)

    def decode(self, latent: jax.Array, *, train: bool) -> jax.Array:
        """Maps latents (B, latent_dim) to mean-subtracted poses (B, 34, pose_dim)."""
        return self.decoder(latent, train=train)


def _activate(x: jax.Array, name: str, train: bool) -> jax.Array:
    return nn.leaky_relu(BatchNorm(name=name)(x, train=train), _SLOPE)


def _linear(values: int, *, name: str) -> nn.Dense:
    return nn.Dense(values, kernel_init=initializers.LINEAR, name=name)


def _conv(channels: int, kernel: int, stride: int, *, name: str) -> nn.Conv:
    return nn.Conv(channels, (kernel,), stride, padding="VALID", kernel_init=initializers.LINEAR, name=name)


def _transposed_conv(channels: int, *, name: str) -> nn.ConvTranspose:
    return nn.ConvTranspose(channels, (3,), padding="VALID", kernel_init=initializers.LINEAR, name=name)
