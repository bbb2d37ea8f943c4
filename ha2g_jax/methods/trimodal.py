"""Trimodal (Yoon et al. 2020): from speech, words and speaker to poses, with adversarial and style diverging losses."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from flax import linen as nn

from ha2g_jax.config.settings import Config
from ha2g_jax.layers.gru import FrameDecoder
from ha2g_jax.layers.identity import ImageIdentity, SpeakerIdentity
from ha2g_jax.layers.resnet_se import AudioEncoder
from ha2g_jax.layers.tcn import TextEncoder
from ha2g_jax.layers.waveform import WaveformEncoder
from ha2g_jax.methods import networks
from ha2g_jax.methods.adversarial import Discriminator
from ha2g_jax.methods.ha2g.losses import huber, kld, style
from ha2g_jax.methods.method import FLOAT32, Batch, Compute, Run, Spec, Variables, generator_arguments, make_spec
from ha2g_jax.methods.networks import apply, audio_encoder, identity_encoder, infer_both, speech_features, text_encoder
from ha2g_jax.skeleton import Skeleton


class Trimodal(nn.Module):
    """Generator from speech audio, its words, a speaker and M seed poses to N poses.

    Every method can be the `method=` of `apply`. Poses are flat, mean-subtracted direction vectors (D1). All but
    `infer` use "batch_stats"; it and `encode_speech` draw from the stream "dropout" in training.
    """

    audio: WaveformEncoder | AudioEncoder
    text: TextEncoder | None  # None for a model that reads no words
    identity: SpeakerIdentity | ImageIdentity
    pose_dim: int
    hidden_dim: int = 300
    layers: int = 4
    dropout: float = 0.3
    slope: float = 0.01

    def setup(self) -> None:
        self.decoder = FrameDecoder(self.pose_dim, self.hidden_dim, self.layers, self.dropout, self.slope)

    def __call__(
        self, inputs: dict[str, jax.Array], identity: jax.Array, seed_pose: jax.Array, *, train: bool
    ) -> tuple[jax.Array, ...]:
        """Run every part once, with the mean for the style; returns the poses, as `infer`."""
        mean, _ = self.encode_identity(identity, train=train)
        return self.infer(self.encode_speech(inputs, train=train), mean, seed_pose, train=train)

    def encode_speech(self, inputs: dict[str, jax.Array], *, train: bool) -> jax.Array:
        """Map "audio" (B, 36267), or "mel", and "words" (B, N) to (B, N, features); see `networks.speech_features`."""
        return speech_features(self.audio, self.text, inputs, train=train)

    def encode_identity(self, identity: jax.Array, *, train: bool) -> tuple[jax.Array, jax.Array]:
        """Map speaker indices (B,) or images to mean and log-variance of z, each (B, style_dim)."""
        return self.identity(identity, train=train)

    def infer(
        self, features: jax.Array, style: jax.Array, seed_pose: jax.Array, *, train: bool
    ) -> tuple[jax.Array, ...]:
        """Decode poses; every frame reads its seed pose or zeros, a bit that marks seeds, the speech and the style.

        Features (B, N, features) of `encode_speech`, a style z (B, style_dim) and the true poses (B, M, pose_dim) of
        the first M frames give one level (B, N, pose_dim), in which the seed frames are predicted as well. Poses are
        mean-subtracted.
        """
        (batch, num_frames), num_seed_frames = features.shape[:2], seed_pose.shape[1]
        marked = jnp.concatenate([seed_pose, jnp.ones_like(seed_pose[..., :1])], axis=-1)
        known = jnp.pad(marked, ((0, 0), (0, num_frames - num_seed_frames), (0, 0)))
        styles = jnp.broadcast_to(style[:, None], (batch, num_frames, style.shape[-1]))
        return (self.decoder(jnp.concatenate([known, features, styles], axis=-1), train=train),)


rngs: tuple[str, ...] = ("dropout", "identity", "permutation")
reconstruction_term = "huber"
has_parts = False
init_arguments = generator_arguments
encode_speech, encode_identity, sample = networks.encode_speech, networks.encode_identity, networks.sample


# Slopes of the decoder and of the discriminator for negative values. The release passes True, which makes them 1 and
# the activations the identity.
_SLOPES = {"paper": (0.01, 0.2), "release": (1.0, 1.0)}


class Terms(NamedTuple):
    """Terms of the objective, each an unweighted scalar (), or their weights as floats."""

    huber: jax.Array
    style: jax.Array
    kld: jax.Array
    gan: jax.Array


class LossSettings(NamedTuple):
    """Settings of the terms, `config.loss.trimodal`; the table of settings explains them."""

    huber_delta: float
    style_clip: float


class Outputs(NamedTuple):
    """Outputs of the generator that gradients flow through."""

    poses: tuple[jax.Array]  # one level, (B, N, pose_dim), mean-subtracted
    mean: jax.Array  # (B, 16) of the style, like the log-variance
    log_variance: jax.Array


class Constants(NamedTuple):
    """Values for the style term, without a gradient: each clip's z, the style `other_z` of another speaker of the
    batch, both (B, 16), and the poses of the same speech in that style.
    """

    poses: jax.Array
    z: jax.Array
    other_z: jax.Array


def build(config: Config, skeleton: Skeleton, vocabulary_size: int, num_speakers: int) -> Spec:
    """Build the networks of `config.model`, with the discriminator of HA2G. See `Method.build`."""
    has_words = config.model.text.kind == "tcn"
    inferer, (slope, discriminator_slope) = config.model.inferer, _SLOPES[config.model.architecture]
    audio = audio_encoder(config)
    generator = Trimodal(
        audio=audio,
        text=text_encoder(config, vocabulary_size) if has_words else None,
        identity=identity_encoder(config, num_speakers, has_hidden=True),
        pose_dim=skeleton.pose_dim,
        hidden_dim=inferer.hidden_dim,
        layers=inferer.layers,
        dropout=inferer.dropout,
        slope=slope,
    )
    discriminator = Discriminator(**config.model.discriminator, slope=discriminator_slope)
    return make_spec(config, skeleton, generator, discriminator, inputs=audio.inputs + ("words",) * has_words)


def run(
    spec: Spec,
    variables: Variables,
    batch: Batch,
    keys: dict[str, jax.Array],
    *,
    train: bool = True,
    compute: Compute = FLOAT32,
) -> Run[Outputs, Constants]:
    """Run the generator on one batch, with its own speakers and, without a gradient, with a permutation of them.

    Each of the two has its own sample of the style, so that they differ even where a speaker stays in place.
    In evaluation mode the style is the mean, not a sample. See `Method.run`.
    """
    speech, speaker, seed_pose = generator_arguments(spec, batch)
    (features, (mean, log_variance)), batch_stats = apply(
        spec.generator, variables, keys["dropout"], speech, speaker, train=train, compute=compute, method=_encode
    )
    order = jax.random.permutation(keys["permutation"], len(mean))
    z, other_z = mean, mean[order]
    if train:
        noise = jax.random.normal(keys["identity"], (2, *mean.shape), mean.dtype)
        deviation = jnp.exp(0.5 * log_variance)
        z, other_z = z + deviation * noise[0], other_z + deviation[order] * noise[1]
    other_z = jax.lax.stop_gradient(other_z)

    clips = (features, z, other_z, seed_pose)
    (poses,), other_poses = infer_both(spec, variables, keys["dropout"], *clips, train=train, compute=compute)
    return Run(Outputs((poses,), mean, log_variance), Constants(other_poses, z, other_z), batch_stats)


def _encode(model: Trimodal, speech: dict[str, jax.Array], speaker: jax.Array, *, train: bool) -> Any:
    return model.encode_speech(speech, train=train), model.encode_identity(speaker, train=train)


def terms(
    spec: Spec, settings: LossSettings, outputs: Outputs, constants: Constants, targets: jax.Array, gan: jax.Array
) -> Terms:
    """Return the unweighted terms; see `Method.terms`."""
    del spec
    (poses,) = outputs.poses
    return Terms(
        gan=gan,
        huber=huber((poses,), (targets,), settings.huber_delta),
        style=style(poses, *constants, clip=settings.style_clip),
        kld=kld(outputs.mean, outputs.log_variance),
    )
