"""HA2G, the generator with the networks of the authors' public code, which run the released weights.

It differs from the paper and from `model.py` as follows. Every level of the motion has its own text encoder and table
of speakers, whose features and style its GRU reads, so that generation needs words. A perceptron maps the states of the
GRU to poses. Identities come from a table; the style coordinator is a perceptron with a table of its own. The networks
read the spectrogram in dB. docs/released_weights.md has the whole comparison.
"""

import reprlib
from typing import NamedTuple

import jax
import jax.numpy as jnp
from flax import linen as nn

from ha2g_jax.config.settings import Config, value_of
from ha2g_jax.errors import UserError
from ha2g_jax.layers import initializers
from ha2g_jax.layers.gru import FrameDecoder
from ha2g_jax.layers.identity import SpeakerIdentity
from ha2g_jax.layers.linear import Embedding, Linear
from ha2g_jax.layers.resnet_se import AudioEncoder
from ha2g_jax.layers.tcn import TextEncoder
from ha2g_jax.methods.adversarial import Discriminator
from ha2g_jax.methods.ha2g import method as paper
from ha2g_jax.methods.method import FLOAT32, Batch, Compute, Run, Spec, Variables, make_spec
from ha2g_jax.methods.networks import resnet_se, speaker_table, text_encoder
from ha2g_jax.skeleton import Skeleton

_HEAD_BONES = 5  # the last ones of every level of TED-Expressive
_COORDINATOR_DIM = 32
_DISCRIMINATOR_SLOPE = 0.01
# Settings that only the networks of the paper can vary, and their fixed values here.
_FIXED = {
    "model.audio.kind": "resnet_se",
    "model.audio.levels": ("low", "mid", "high"),
    "model.text.kind": "tcn",
    "model.text.receptive_field": "causal",
    "model.identity.kind": "speakers",
    "model.inferer.levels": (),
    "model.inferer.coordinator": "levels",
}

rngs, Terms, reconstruction_term, has_parts = paper.rngs, paper.Terms, paper.reconstruction_term, paper.has_parts
init_arguments, encode_speech, encode_identity = paper.init_arguments, paper.encode_speech, paper.encode_identity
sample, LossSettings, terms = paper.sample, paper.LossSettings, paper.terms


class SpeechFeatures(NamedTuple):
    """Features of the speech: audio, each (B, N, 32), and the text of each level of the motion, H arrays (B, N, 32)."""

    low: jax.Array
    mid: jax.Array
    high: jax.Array
    texts: tuple[jax.Array, ...]


class ReleaseStage(nn.Module):
    """The networks of one level of the motion: encoders of the words and of the speaker, and a decoder.

    The decoder maps [pose, bit, audio, text, style] of each frame (B, N, d^h + 81) to p^h (B, N, d^h).
    """

    text: TextEncoder
    identity: SpeakerIdentity
    pose_dim: int
    hidden_dim: int
    layers: int
    dropout: float

    def setup(self) -> None:
        self.decoder = FrameDecoder(self.pose_dim, self.hidden_dim, self.layers, self.dropout)


class ReleaseCoordinator(nn.Module):
    """Weights of the audio levels in each level of the motion, computed from its own table of speakers."""

    num_speakers: int
    feature_dim: int
    num_levels: int

    def setup(self) -> None:
        self.embedding = Embedding(self.num_speakers, self.feature_dim, embedding_init=initializers.normal(1.0))
        self.linear_1 = Linear(self.feature_dim)
        self.linear_2 = Linear(_COORDINATOR_DIM)
        self.linear_3 = Linear(3 * self.num_levels)

    def encode(self, speaker: jax.Array) -> jax.Array:
        """Map speaker indices (B,) to the values (B, 16) that `blend` reads."""
        return self.linear_1(self.embedding(speaker))

    def blend(self, values: jax.Array) -> jax.Array:
        """Map the values of a speaker (B, 16) to C (B, 3, H), whose columns over low, mid and high sum to 1."""
        scores = self.linear_3(nn.elu(self.linear_2(nn.elu(values))))
        scores = scores.reshape(len(values), 3, self.num_levels)
        return nn.softmax(scores.astype(jnp.float32), axis=1).astype(scores.dtype)


class ReleaseHA2G(nn.Module):
    """Generator from speech audio, its words, a speaker and M seed poses to N poses on each level of the hierarchy.

    It has the methods and fields of `model.HA2G`. A style f_id has 16 (1 + H) values: first the 16 that the style
    coordinator reads, which are not sampled, then the style of each level.

    Attributes:
        text: encoder of the words for the contrastive loss only; each level has one like it.
        identity: table of speakers; each level has one like it.
        has_shifted_head: whether the bones of the head enter the levels after the first shifted by one channel, as in
            the released networks of TED-Expressive.
    """

    audio: AudioEncoder
    text: TextEncoder
    identity: SpeakerIdentity
    level_channels: tuple[tuple[int, ...], ...]
    num_seed_frames: int = 4
    has_shifted_head: bool = False
    hidden_dim: int = 300
    layers: int = 4
    dropout: float = 0.3

    def setup(self) -> None:
        identity = self.identity
        self.coordinator = ReleaseCoordinator(identity.num_speakers, identity.feature_dim, len(self.level_channels))
        self.stages = [
            ReleaseStage(
                text=self.text.clone(parent=None, name=None),
                identity=identity.clone(parent=None, name=None),
                pose_dim=len(channels),
                hidden_dim=self.hidden_dim,
                layers=self.layers,
                dropout=self.dropout,
                name=f"pose_{level}",
            )
            for level, channels in enumerate(self.level_channels, 1)
        ]

    def __call__(
        self, inputs: dict[str, jax.Array], identity: jax.Array, seed_pose: jax.Array, *, train: bool
    ) -> tuple[jax.Array, ...]:
        """Run every part once, with the mean for f_id; returns the poses of each level, as `infer`."""
        features = self.encode_speech(inputs, train=train)
        self.encode_text(inputs["words"], train=train)
        mean, _ = self.encode_identity(identity, train=train)
        return self.infer(features, mean, seed_pose, train=train)

    def encode_speech(self, inputs: dict[str, jax.Array], *, train: bool) -> SpeechFeatures:
        """Map "mel" (B, 128, 70) in dB and "words" (B, N) to features of the audio and of the text of each level."""
        audio = self.audio(inputs["mel"], train=train)
        texts = tuple(stage.text(inputs["words"], train=train) for stage in self.stages)
        return SpeechFeatures(audio.low, audio.mid, audio.high, texts)

    def encode_text(self, words: jax.Array, *, train: bool) -> jax.Array:
        """Map word indices on frames (B, N) to f_t (B, N, 32), which serves the contrastive loss only."""
        return self.text(words, train=train)

    def encode_identity(self, identity: jax.Array, *, train: bool) -> tuple[jax.Array, jax.Array]:
        """Map speaker indices (B,) to mean and log-variance of f_id, each (B, 16 (1 + H)).

        The values of the blend have no noise: their log-variance is minus infinity.
        """
        blend = self.coordinator.encode(identity)
        levels = [stage.identity(identity, train=train) for stage in self.stages]
        means, log_variances = zip(*levels, strict=True)
        exact = jnp.full_like(blend, -jnp.inf)
        return jnp.concatenate([blend, *means], axis=-1), jnp.concatenate([exact, *log_variances], axis=-1)

    def coordinate(self, f_id: jax.Array) -> jax.Array:
        """Map f_id (B, 16 (1 + H)) to the style coordinator C (B, 3, H)."""
        return self.coordinator.blend(f_id[:, : self.identity.feature_dim])

    def infer(
        self, features: SpeechFeatures, f_id: jax.Array, seed_pose: jax.Array, *, train: bool
    ) -> tuple[jax.Array, ...]:
        """Infer poses, coarse to fine, as `model.HA2G.infer` does; the identity f_id is (B, 16 (1 + H))."""
        low, mid, high, texts = features
        blended = jnp.einsum("blh,blnf->hbnf", self.coordinate(f_id), jnp.stack([low, mid, high], axis=1))  # Eq. 3
        styles = jnp.split(f_id[:, self.identity.feature_dim :], len(self.level_channels), axis=-1)
        poses: list[jax.Array] = []
        for level, stage in enumerate(self.stages):
            known = self._known(level, poses, seed_pose, low.shape[1])
            style = jnp.broadcast_to(styles[level][:, None], (*low.shape[:2], styles[level].shape[-1]))
            x = jnp.concatenate([known, blended[level], texts[level], style], axis=-1)
            poses.append(stage.decoder(x, train=train))
        return tuple(poses)

    def _known(self, level: int, poses: list[jax.Array], seed_pose: jax.Array, num_frames: int) -> jax.Array:
        """Return the poses that a level reads and the bit that marks the seed, (B, N, d^h + 1).

        In the frames of the seed these are, at every level, the seed poses and 1; after them the poses of the level
        below, zeros in the channels that the level adds, and 0.
        """
        channels = self.level_channels[level]
        given = jnp.concatenate([seed_pose[..., jnp.array(channels)], jnp.ones_like(seed_pose[..., :1])], axis=-1)
        free = jnp.zeros((len(seed_pose), num_frames - self.num_seed_frames, len(channels) + 1), seed_pose.dtype)
        if poses:
            places = [channels.index(channel) for channel in self.level_channels[level - 1]]
            if self.has_shifted_head:  # the last channel overwrites the bit
                head = 3 * _HEAD_BONES
                places = places[:-head] + [place + 1 for place in places[-head:]]
            free = free.at[..., jnp.array(places)].set(poses[-1][:, self.num_seed_frames :], unique_indices=True)
        return jnp.concatenate([given, free], axis=1)


def build(config: Config, skeleton: Skeleton, vocabulary_size: int, num_speakers: int) -> Spec:
    """Build the networks of `config.model` with architecture "release"; see `Method.build`.

    Raises:
        UserError: a setting that these networks cannot vary has another value.
    """
    for name, expected in _FIXED.items():
        if (value := value_of(config, name)) != expected:
            raise UserError(
                f"config.{name} is {reprlib.repr(value)}, expected {expected!r}, which the networks of the release "
                f"have: set --config.{name}"
            )
    inferer = config.model.inferer
    generator = ReleaseHA2G(
        audio=resnet_se(config, reads_decibels=True),
        text=text_encoder(config, vocabulary_size),
        identity=speaker_table(config, num_speakers, has_hidden=True),
        level_channels=skeleton.level_channels,
        num_seed_frames=config.data.num_seed_frames,
        has_shifted_head=skeleton.name == "ted_expressive",
        hidden_dim=inferer.hidden_dim,
        layers=inferer.layers,
        dropout=inferer.dropout,
    )
    discriminator = Discriminator(**config.model.discriminator, slope=_DISCRIMINATOR_SLOPE)
    spec = make_spec(config, skeleton, generator, discriminator, inputs=("mel", "words"))
    return spec._replace(style_dim=config.model.identity.feature_dim * (1 + skeleton.num_levels))


def run(
    spec: Spec,
    variables: Variables,
    batch: Batch,
    keys: dict[str, jax.Array],
    *,
    train: bool = True,
    compute: Compute = FLOAT32,
) -> Run[paper.Outputs, paper.Constants]:
    """Run the generator as HA2G's `run` does; the terms see the style of the last level instead of the whole f_id."""
    size = spec.generator.identity.feature_dim

    def exchange(f_id: jax.Array, shift: jax.Array) -> jax.Array:
        """Give each clip the styles of another one, but keep the values that the coordinator reads."""
        return jnp.concatenate([f_id[:, :size], jnp.roll(f_id[:, size:], shift, axis=0)], axis=-1)

    outputs, constants, batch_stats = paper.run(
        spec, variables, batch, keys, train=train, compute=compute, exchange=exchange
    )
    mean, log_variance, f_id, other_f_id = (
        values[:, -size:] for values in (outputs.mean, outputs.log_variance, constants.f_id, constants.other_f_id)
    )
    outputs = outputs._replace(mean=mean, log_variance=log_variance)
    return Run(outputs, constants._replace(f_id=f_id, other_f_id=other_f_id), batch_stats)
