"""Joint Embedding (Ahuja and Morency 2019), as HA2G compares with it: speech and poses share a latent space."""

import jax
import jax.numpy as jnp
from flax import linen as nn

from ha2g_jax.models import initializers
from ha2g_jax.models.autoencoder import PoseEncoder
from ha2g_jax.models.baselines.frame_decoder import FrameDecoder
from ha2g_jax.models.baselines.waveform import WaveformEncoder
from ha2g_jax.models.gru import GRU
from ha2g_jax.models.norm import BatchNorm
from ha2g_jax.models.tcn import TextEncoder

_SEED_DIM = 32


class ContextEncoder(nn.Module):
    """Speech features of a window to the distribution of its latent.

    Attributes:
        latent_dim: values of the latent.
        hidden_dim, layers: of the GRU, which runs forward in time.
    """

    latent_dim: int
    hidden_dim: int
    layers: int

    @nn.compact
    def __call__(self, features: jax.Array, *, train: bool) -> tuple[jax.Array, jax.Array]:
        """Maps (B, N, features) to mean and log-variance, each (B, latent_dim)."""
        x = GRU(self.hidden_dim, self.layers, name="gru")(features)[:, -1]
        x = _linear(self.hidden_dim // 2, "linear_1")(x)
        x = nn.relu(BatchNorm(name="norm")(x, train=train))
        return _heads(_linear(self.latent_dim, "linear_2")(x), self.latent_dim)


class LatentPoseEncoder(nn.Module):
    """Poses of a window to the distribution of their latent, by the encoder of the pose auto-encoder.

    Its slope is 0.2 in all layers, as the tables have it.
    """

    latent_dim: int

    @nn.compact
    def __call__(self, poses: jax.Array, *, train: bool) -> tuple[jax.Array, jax.Array]:
        """Maps (B, N, pose_dim) to mean and log-variance, each (B, latent_dim)."""
        return _heads(PoseEncoder(self.latent_dim, name="encoder")(poses, train=train), self.latent_dim)


class SeedEncoder(nn.Module):
    """Seed poses (B, M, pose_dim) to one vector (B, 32)."""

    @nn.compact
    def __call__(self, seed: jax.Array, *, train: bool) -> jax.Array:
        x = _linear(_SEED_DIM, "linear_1")(seed.reshape(seed.shape[0], -1))
        x = nn.relu(BatchNorm(name="norm")(x, train=train))
        return _linear(_SEED_DIM, "linear_2")(x)


class JointEmbedding(nn.Module):
    """Speech audio, its words and M seed poses to N poses, by way of one latent a window.

    Every method can be the `method=` of `apply`. Poses are flat, mean-subtracted direction vectors (D1). All methods
    use "batch_stats"; `listen`, `decode` and `infer` draw from the stream "dropout" in training.

    Attributes:
        audio: encoder of the samples.
        text: encoder of the words on frames.
        pose_dim: values of a flat pose.
        num_frames: N.
        latent_dim: values of the latent.
        context_dim, context_layers: of the GRU that reads the speech features.
        hidden_dim, layers, dropout: of the decoder's GRU.
    """

    audio: WaveformEncoder
    text: TextEncoder
    pose_dim: int
    num_frames: int = 34
    latent_dim: int = 32
    context_dim: int = 256
    context_layers: int = 2
    hidden_dim: int = 300
    layers: int = 4
    dropout: float = 0.3

    inputs = ("audio", "words")

    def setup(self) -> None:
        self.context = ContextEncoder(self.latent_dim, self.context_dim, self.context_layers)
        self.pose_encoder = LatentPoseEncoder(self.latent_dim)
        self.seed_encoder = SeedEncoder()
        self.decoder = FrameDecoder(self.pose_dim, self.hidden_dim, self.layers, self.dropout)

    @property
    def style_dim(self) -> int:
        """Values of the noise that a latent is sampled with; there are no speakers."""
        return self.latent_dim

    def __call__(
        self, inputs: dict[str, jax.Array], identity: None, seed: jax.Array, *, train: bool
    ) -> tuple[jax.Array, ...]:
        """Runs every part once, without noise; returns the poses, as `infer`."""
        del identity  # None; the argument is that of the other methods.
        heard = self.listen(inputs, train=train)
        poses = self.infer(heard, jnp.zeros_like(heard[0]), seed, train=train)
        self.encode_pose(poses[-1], train=train)
        return poses

    def listen(self, inputs: dict[str, jax.Array], *, train: bool) -> tuple[jax.Array, jax.Array]:
        """Maps "audio" (B, 36267) and "words" (B, N) to mean and log-variance of the latent, each (B, 32)."""
        audio, text = self.audio(inputs["audio"], train=train), self.text(inputs["words"], train=train)
        return self.context(jnp.concatenate([audio, text], axis=-1), train=train)

    def encode_pose(self, poses: jax.Array, *, train: bool) -> tuple[jax.Array, jax.Array]:
        """Maps true poses (B, N, pose_dim) to mean and log-variance; training takes the mean for the latent."""
        return self.pose_encoder(poses, train=train)

    def decode(self, latent: jax.Array, seed: jax.Array, *, train: bool) -> jax.Array:
        """Maps a latent (B, 32), of speech or of poses, and the seed (B, M, pose_dim) to poses (B, N, pose_dim)."""
        x = jnp.concatenate([self.seed_encoder(seed, train=train), latent], axis=-1)
        return self.decoder(jnp.repeat(x[:, None], self.num_frames, axis=1), train=train)

    def infer(
        self, heard: tuple[jax.Array, jax.Array], style: jax.Array, seed: jax.Array, *, train: bool
    ) -> tuple[jax.Array, ...]:
        """Samples the latent of the speech and decodes it.

        Args:
            heard: mean and log-variance of `listen`.
            style: (B, 32) noise; from N(0, I) it gives a sample, zeros give the mean.
            seed: (B, M, pose_dim) true poses of the first M frames, mean-subtracted.

        Returns:
            One level, (B, N, pose_dim), mean-subtracted, the seed frames predicted as well.
        """
        return (self.decode(sample(heard, style), seed, train=train),)


def sample(distribution: tuple[jax.Array, jax.Array], noise: jax.Array) -> jax.Array:
    """mean + exp(0.5 log-variance) noise, all (B, latent_dim)."""
    mean, log_variance = distribution
    return mean + jnp.exp(0.5 * log_variance) * noise


def _heads(x: jax.Array, latent_dim: int) -> tuple[jax.Array, jax.Array]:
    return _linear(latent_dim, "mean")(x), _linear(latent_dim, "log_variance")(x)


def _linear(values: int, name: str) -> nn.Dense:
    return nn.Dense(values, kernel_init=initializers.LINEAR, name=name)
