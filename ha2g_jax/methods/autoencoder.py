"""The pose auto-encoder of the Frechet gesture distance (HA2G, Table 9), trained like any other method.

With `config.model.architecture = "release"` it has the networks of the public code: the activations between the linear
maps have slope 1, which makes them the identity, and on TED-Gesture a further linear map gives the latent.

The paper does not say how it was trained. Our loss is the mean L1 error of the poses and of their velocities, plus a
small cosine term between restored direction vectors; we chose it on the validation split.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from flax import linen as nn

from ha2g_jax.config.settings import Config
from ha2g_jax.layers import initializers
from ha2g_jax.layers.conv import BatchNorm
from ha2g_jax.layers.linear import Linear
from ha2g_jax.methods.method import (
    FLOAT32,
    Batch,
    Compute,
    NoSettings,
    Poses,
    Run,
    Spec,
    Variables,
    make_spec,
    restore,
    subtract_mean,
)
from ha2g_jax.methods.networks import apply
from ha2g_jax.skeleton import Skeleton, normalize

# Size of the latent for each skeleton: Table 9, and Yoon et al. 2020 for TED-Gesture.
LATENT_DIMS = {"ted_expressive": 128, "ted_gesture": 32}

_SLOPE = 0.2


class PoseEncoder(nn.Module):
    """Encoder of poses (B, N, pose_dim) to a latent (B, latent_dim).

    `slope` is that of the activations between the linear maps for negative values. With `has_mean`, one more linear map
    gives the mean of a Gaussian.
    """

    latent_dim: int
    slope: float = _SLOPE
    has_mean: bool = False

    @nn.compact
    def __call__(self, poses: jax.Array, *, train: bool) -> jax.Array:
        x = _conv(32, 3, 1, name="conv_1")(poses)
        x = _conv(64, 3, 1, name="conv_2")(_activate(x, "norm_1", train))
        x = _conv(64, 4, 2, name="conv_3")(_activate(x, "norm_2", train))
        x = _conv(32, 3, 1, name="conv_4")(_activate(x, "norm_3", train))
        x = x.transpose(0, 2, 1).reshape(x.shape[0], -1)  # channel-major, as PyTorch flattens (C, N)
        x = _activate(Linear(256, name="linear_1")(x), "norm_4", train, self.slope)
        x = _activate(Linear(128, name="linear_2")(x), "norm_5", train, self.slope)
        x = Linear(self.latent_dim, name="linear_3")(x)
        return Linear(self.latent_dim, name="mean")(x) if self.has_mean else x


class PoseDecoder(nn.Module):
    """Decoder of a latent (B, latent_dim) to poses (B, N, pose_dim)."""

    pose_dim: int
    num_frames: int = 34
    slope: float = _SLOPE

    @nn.compact
    def __call__(self, latent: jax.Array, *, train: bool) -> jax.Array:
        x = _activate(Linear(64, name="linear_1")(latent), "norm_1", train, self.slope)
        x = Linear(4 * self.num_frames, name="linear_2")(x)
        x = x.reshape(x.shape[0], 4, self.num_frames).transpose(0, 2, 1)
        x = _activate(_transposed_conv(32, name="conv_1")(x), "norm_2", train)
        x = _activate(_transposed_conv(32, name="conv_2")(x), "norm_3", train)
        x = _conv(32, 3, 1, name="conv_3")(x)
        return _conv(self.pose_dim, 3, 1, name="conv_4")(x)


class PoseAutoencoder(nn.Module):
    """Auto-encoder of windows of poses. `encode` and `decode` can be the `method=` of `apply`."""

    pose_dim: int
    latent_dim: int
    num_frames: int = 34
    slope: float = _SLOPE
    has_mean: bool = False

    def setup(self) -> None:
        self.encoder = PoseEncoder(self.latent_dim, self.slope, self.has_mean)
        self.decoder = PoseDecoder(self.pose_dim, self.num_frames, self.slope)

    def __call__(self, poses: jax.Array, *, train: bool) -> jax.Array:
        """Map mean-subtracted poses (B, N, pose_dim) to their reconstruction."""
        return self.decode(self.encode(poses, train=train), train=train)

    def encode(self, poses: jax.Array, *, train: bool) -> jax.Array:
        """Map mean-subtracted poses (B, N, pose_dim) to latents (B, latent_dim)."""
        return self.encoder(poses, train=train)

    def decode(self, latent: jax.Array, *, train: bool) -> jax.Array:
        """Map latents (B, latent_dim) to mean-subtracted poses (B, N, pose_dim)."""
        return self.decoder(latent, train=train)


def _activate(x: jax.Array, name: str, train: bool, slope: float = _SLOPE) -> jax.Array:
    return nn.leaky_relu(BatchNorm(name=name)(x, train=train), slope)


def _conv(channels: int, kernel: int, stride: int, *, name: str) -> nn.Conv:
    return nn.Conv(channels, (kernel,), stride, padding="VALID", kernel_init=initializers.LINEAR, name=name)


def _transposed_conv(channels: int, *, name: str) -> nn.ConvTranspose:
    return nn.ConvTranspose(channels, (3,), padding="VALID", kernel_init=initializers.LINEAR, name=name)


def reconstruction(poses: jax.Array, targets: jax.Array) -> jax.Array:
    """Return the mean absolute error of poses (B, N, pose_dim)."""
    return jnp.mean(jnp.abs(poses - targets))


def velocity(poses: jax.Array, targets: jax.Array) -> jax.Array:
    """Return the mean absolute error of the differences between neighbouring frames of poses (B, N, pose_dim)."""
    return jnp.mean(jnp.abs(jnp.diff(poses, axis=1) - jnp.diff(targets, axis=1)))


def cosine(directions: jax.Array, target_directions: jax.Array) -> jax.Array:
    """Return the mean of 1 - cosine between direction vectors (B, N, bones, 3)."""
    return jnp.mean(1 - jnp.sum(normalize(directions) * normalize(target_directions), axis=-1))


rngs: tuple[str, ...] = ("dropout",)
reconstruction_term = "reconstruction"
has_parts = False
LossSettings = NoSettings


class Terms(NamedTuple):
    """Terms of the objective, each an unweighted scalar (), or their weights as floats."""

    reconstruction: jax.Array
    velocity: jax.Array
    cosine: jax.Array


def build(config: Config, skeleton: Skeleton, vocabulary_size: int, num_speakers: int) -> Spec:
    """Build the auto-encoder of a skeleton.

    No setting changes it: distances measured with different auto-encoders cannot be compared.
    """
    del vocabulary_size, num_speakers
    is_release = config.model.architecture == "release"
    generator = PoseAutoencoder(
        skeleton.pose_dim,
        LATENT_DIMS[skeleton.name],
        config.data.num_frames,
        slope=1.0 if is_release else _SLOPE,
        has_mean=is_release and skeleton.name == "ted_gesture",
    )
    return make_spec(config, skeleton, generator, inputs=())


def init_arguments(spec: Spec, batch: Batch) -> tuple[jax.Array]:
    """Return the poses of a batch; see `Method.init_arguments`."""
    return (subtract_mean(spec, batch["directions"]),)


def run(
    spec: Spec,
    variables: Variables,
    batch: Batch,
    keys: dict[str, jax.Array],
    *,
    train: bool = True,
    compute: Compute = FLOAT32,
) -> Run[Poses, None]:
    """Encode and decode the windows of a batch; see `Method.run`."""
    (poses,) = init_arguments(spec, batch)
    poses, batch_stats = apply(spec.generator, variables, keys["dropout"], poses, train=train, compute=compute)
    return Run(Poses((poses,)), None, batch_stats)


def terms(spec: Spec, settings: NoSettings, outputs: Poses, constants: None, targets: jax.Array, gan: None) -> Terms:
    """Return the unweighted terms; see `Method.terms`."""
    del settings, constants, gan
    (poses,) = outputs.poses
    return Terms(
        reconstruction=reconstruction(poses, targets),
        velocity=velocity(poses, targets),
        cosine=cosine(restore(spec, poses), restore(spec, targets)),
    )
