"""Joint Embedding (Ahuja and Morency 2019): one decoder for the latents of speech and of poses."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from flax import linen as nn

from ha2g_jax.config.settings import Config
from ha2g_jax.layers.conv import BatchNorm
from ha2g_jax.layers.gru import GRU, FrameDecoder
from ha2g_jax.layers.linear import Linear, mean_and_log_variance
from ha2g_jax.layers.resnet_se import AudioEncoder
from ha2g_jax.layers.tcn import TextEncoder
from ha2g_jax.layers.waveform import WaveformEncoder
from ha2g_jax.methods import networks
from ha2g_jax.methods.autoencoder import PoseEncoder
from ha2g_jax.methods.method import (
    FLOAT32,
    Batch,
    Compute,
    NoSettings,
    Poses,
    Run,
    Spec,
    Variables,
    generator_arguments,
    make_spec,
    subtract_mean,
)
from ha2g_jax.methods.networks import apply, audio_encoder, identity_encoder, mean_style, speech_features, text_encoder
from ha2g_jax.skeleton import Skeleton

_SEED_DIM = 32


class ContextEncoder(nn.Module):
    """Encoder of the speech features of a window to the distribution of its latent."""

    latent_dim: int
    hidden_dim: int
    layers: int

    @nn.compact
    def __call__(self, features: jax.Array, *, train: bool) -> tuple[jax.Array, jax.Array]:
        """Map (B, N, features) to mean and log-variance, each (B, latent_dim)."""
        x = GRU(self.hidden_dim, self.layers, name="gru")(features)[:, -1]
        x = Linear(self.hidden_dim // 2, name="linear_1")(x)
        x = nn.relu(BatchNorm(name="norm")(x, train=train))
        return mean_and_log_variance(Linear(self.latent_dim, name="linear_2")(x), self.latent_dim)


class LatentPoseEncoder(nn.Module):
    """Encoder of the poses of a window to the distribution of their latent, built like that of the pose auto-encoder.

    Its slope is 0.2 in all layers, as in the tables.
    """

    latent_dim: int

    @nn.compact
    def __call__(self, poses: jax.Array, *, train: bool) -> tuple[jax.Array, jax.Array]:
        """Map (B, N, pose_dim) to mean and log-variance, each (B, latent_dim)."""
        return mean_and_log_variance(PoseEncoder(self.latent_dim, name="encoder")(poses, train=train), self.latent_dim)


class SeedEncoder(nn.Module):
    """Encoder of seed poses (B, M, pose_dim) to one vector (B, 32)."""

    @nn.compact
    def __call__(self, seed_pose: jax.Array, *, train: bool) -> jax.Array:
        x = Linear(_SEED_DIM, name="linear_1")(seed_pose.reshape(seed_pose.shape[0], -1))
        x = nn.relu(BatchNorm(name="norm")(x, train=train))
        return Linear(_SEED_DIM, name="linear_2")(x)


class JointEmbedding(nn.Module):
    """Generator from speech audio, its words, a style and M seed poses to N poses, with one latent for each window.

    Every method can be the `method=` of `apply`. Poses are flat, mean-subtracted direction vectors (D1). All methods
    use "batch_stats"; `encode_speech`, `decode` and `infer` draw from the stream "dropout" in training. `context_dim`
    and `context_layers` are the sizes of the GRU that reads the speech features.
    """

    audio: WaveformEncoder | AudioEncoder
    text: TextEncoder | None  # None for a model that reads no words
    pose_dim: int
    num_frames: int = 34
    latent_dim: int = 32
    context_dim: int = 256
    context_layers: int = 2
    hidden_dim: int = 300
    layers: int = 4
    dropout: float = 0.3
    identity: Any = None  # encoder of images, None for a model without identities

    def setup(self) -> None:
        self.context = ContextEncoder(self.latent_dim, self.context_dim, self.context_layers)
        self.pose_encoder = LatentPoseEncoder(self.latent_dim)
        self.seed_encoder = SeedEncoder()
        self.decoder = FrameDecoder(self.pose_dim, self.hidden_dim, self.layers, self.dropout)

    def __call__(
        self, inputs: dict[str, jax.Array], identity: jax.Array | None, seed_pose: jax.Array, *, train: bool
    ) -> tuple[jax.Array, ...]:
        """Run every part once, without noise; returns the poses, as `infer`."""
        features, style = self.encode_speech(inputs, train=train), mean_style(self, identity, seed_pose, train=train)
        poses = self.infer(features, jnp.zeros_like(features[0]), style, seed_pose, train=train)
        self.encode_pose(poses[-1], train=train)
        return poses

    def encode_speech(self, inputs: dict[str, jax.Array], *, train: bool) -> tuple[jax.Array, jax.Array]:
        """Map "audio" (B, 36267), or "mel", and "words" (B, N) to mean and log-variance of the latent, (B, 32)."""
        return self.context(speech_features(self.audio, self.text, inputs, train=train), train=train)

    def encode_identity(self, images: jax.Array, *, train: bool) -> tuple[jax.Array, jax.Array]:
        """Map images (B, M, S, S, 3) to mean and log-variance of the style, each (B, style_dim)."""
        return self.identity(images, train=train)

    def encode_pose(self, poses: jax.Array, *, train: bool) -> tuple[jax.Array, jax.Array]:
        """Map true poses (B, N, pose_dim) to mean and log-variance; in training the mean is the latent."""
        return self.pose_encoder(poses, train=train)

    def decode(self, latent: jax.Array, style: jax.Array, seed_pose: jax.Array, *, train: bool) -> jax.Array:
        """Map a latent (B, 32), of speech or of poses, a style (B, style_dim) and the seed (B, M, pose_dim) to poses
        (B, N, pose_dim).
        """
        x = jnp.concatenate([self.seed_encoder(seed_pose, train=train), latent, style], axis=-1)
        return self.decoder(jnp.repeat(x[:, None], self.num_frames, axis=1), train=train)

    def infer(
        self,
        features: tuple[jax.Array, jax.Array],
        noise: jax.Array,
        style: jax.Array,
        seed_pose: jax.Array,
        *,
        train: bool,
    ) -> tuple[jax.Array, ...]:
        """Sample the latent of the speech from the mean and log-variance of `encode_speech`, and decode it.

        Noise (B, 32) from N(0, I) gives a sample, zeros give the mean. The style is (B, style_dim), and the seed
        (B, M, pose_dim) the true poses of the first M frames. The result is one level (B, N, pose_dim), in which the
        seed frames are predicted as well. Poses are mean-subtracted.
        """
        return (self.decode(sample_latent(features, noise), style, seed_pose, train=train),)


def sample_latent(distribution: tuple[jax.Array, jax.Array], noise: jax.Array) -> jax.Array:
    """Return mean + exp(0.5 log-variance) noise, all (B, latent_dim)."""
    mean, log_variance = distribution
    return mean + jnp.exp(0.5 * log_variance) * noise


def l1(poses: jax.Array, targets: jax.Array) -> jax.Array:
    """Return the mean absolute error of poses (B, N, pose_dim) in each window, summed over the batch as in the authors'
    code.
    """
    return jnp.sum(jnp.mean(jnp.abs(poses - targets), axis=(1, 2)))


rngs: tuple[str, ...] = ("dropout", "latent", "coin")
reconstruction_term = "l1"
has_parts = False
init_arguments = generator_arguments
encode_speech, encode_identity = networks.encode_speech, networks.encode_identity
LossSettings = NoSettings


class Terms(NamedTuple):
    """The term of the objective, an unweighted scalar (), or its weight as a float."""

    l1: jax.Array


def build(config: Config, skeleton: Skeleton, vocabulary_size: int, num_speakers: int) -> Spec:
    """Build the networks of `config.model`; see `Method.build`."""
    has_words = config.model.text.kind == "tcn"
    audio, context, inferer = audio_encoder(config), config.model.context, config.model.inferer
    generator = JointEmbedding(
        audio=audio,
        text=text_encoder(config, vocabulary_size) if has_words else None,
        pose_dim=skeleton.pose_dim,
        num_frames=config.data.num_frames,
        context_dim=context.hidden_dim,
        context_layers=context.layers,
        hidden_dim=inferer.hidden_dim,
        layers=inferer.layers,
        dropout=inferer.dropout,
        identity=identity_encoder(config, num_speakers),
    )
    inputs = audio.inputs + ("words",) * has_words
    return make_spec(config, skeleton, generator, inputs=inputs, noise_dim=generator.latent_dim)


def sample(
    spec: Spec,
    variables: Variables,
    features: tuple[jax.Array, jax.Array],
    style: jax.Array,
    seed_pose: jax.Array,
    noise: jax.Array,
) -> jax.Array:
    """Generate the poses of windows, each from a sample of its latent; see `GeneratingMethod`.

    The latent takes the noise of the first frame.
    """
    clips = (features, noise[:, 0], style, seed_pose)
    return spec.generator.apply(variables, *clips, train=False, method="infer")[-1]


def run(
    spec: Spec,
    variables: Variables,
    batch: Batch,
    keys: dict[str, jax.Array],
    *,
    train: bool = True,
    compute: Compute = FLOAT32,
) -> Run[Poses, None]:
    """Decode the latent of the speech or, in training with probability 1/2, that of the true poses.

    The choice is made once for each batch. Both encoders run, so that both have the statistics of every batch. The
    latent of the speech is always a sample, in evaluation too, that of the poses never. The style is always the mean of
    the identity, because no term of the objective constrains its distribution. See `Method.run`.
    """
    speech, identity, seed_pose = generator_arguments(spec, batch)
    poses = subtract_mean(spec, batch["directions"])
    noise = jax.random.normal(keys["latent"], (len(poses), spec.generator.latent_dim), poses.dtype)
    from_speech = jax.random.bernoulli(keys["coin"]) if train else jnp.ones((), bool)
    clips = (speech, identity, poses, seed_pose, noise, from_speech)
    decoded, batch_stats = apply(
        spec.generator,
        variables,
        keys["dropout"],
        *clips,
        train=train,
        compute=compute,
        method=_encode_and_decode,
    )
    return Run(Poses((decoded,)), None, batch_stats)


def _encode_and_decode(
    model: JointEmbedding,
    speech: dict[str, jax.Array],
    identity: jax.Array | None,
    poses: jax.Array,
    seed_pose: jax.Array,
    noise: jax.Array,
    from_speech: jax.Array,
    *,
    train: bool,
) -> jax.Array:
    latent, _ = model.encode_pose(poses, train=train)
    latent = jnp.where(from_speech, sample_latent(model.encode_speech(speech, train=train), noise), latent)
    return model.decode(latent, mean_style(model, identity, seed_pose, train=train), seed_pose, train=train)


def terms(spec: Spec, settings: NoSettings, outputs: Poses, constants: None, targets: jax.Array, gan: None) -> Terms:
    """Return the one term; see `Method.terms`."""
    del spec, settings, constants, gan
    return Terms(l1(outputs.poses[-1], targets))
