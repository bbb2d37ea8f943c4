"""HA2G, the generator: hierarchical audio learner and hierarchical pose inferer (HA2G, section 3)."""

from typing import Any

import jax
import jax.numpy as jnp
from flax import linen as nn

from ha2g_jax.layers.gru import BiGRU
from ha2g_jax.layers.identity import ImageIdentity, SpeakerIdentity
from ha2g_jax.layers.linear import Linear
from ha2g_jax.layers.resnet_se import Features
from ha2g_jax.layers.tcn import TextEncoder


class PoseStage(nn.Module):
    """One stage h of the pose inferer (Eq. 4):

        g^h = BiGRU([p^(h-1) ; f_a^h ; bit])        (B, N, hidden_dim), the sum of both directions
        p^h = W^h [g^h ; p^(h-1) ; f_a^h] + b^h     (B, N, d^h)

    D7: the GRU reads p^(h-1), because a bidirectional one cannot be fed its own output. In the frames of the seed pose,
    p^(h-1) is the seed pose and the bit is 1, see `HA2G.infer`.
    """

    pose_dim: int
    hidden_dim: int
    layers: int
    dropout: float

    @nn.compact
    def __call__(self, previous: jax.Array, audio: jax.Array, is_seed: jax.Array, *, train: bool) -> jax.Array:
        """Map p^(h-1) (B, N, channels), f_a^h (B, N, features) and the seed bit (B, N, 1) to p^h (B, N, d^h)."""
        inputs = jnp.concatenate([previous, audio, is_seed], axis=-1)
        hidden = BiGRU(self.hidden_dim, self.layers, self.dropout, name="gru")(inputs, train=train)
        outputs = jnp.concatenate([hidden, previous, audio], axis=-1)
        return Linear(self.pose_dim, name="linear")(outputs)


class StyleCoordinator(nn.Module):
    """Weights of the audio levels in each level of the motion, computed from the identity (HA2G, section 3.2):

        C[l, h] = exp((W f_id)[l, h]) / sum_k exp((W f_id)[k, h]),   k over `audio_levels`

    Attributes:
        audio_levels: those of low, mid and high that are blended; the others have weight 0 (Table 3).
        is_tied: whether all levels of the motion share one column (Table 4, "same audio").
        has_style: whether the weights depend on the identity; otherwise they are the same for all.
    """

    num_levels: int
    audio_levels: tuple[str, ...] = Features._fields
    is_tied: bool = False
    has_style: bool = True

    @nn.compact
    def __call__(self, f_id: jax.Array) -> jax.Array:
        """Map f_id (B, 18) to C (B, 3, H), whose columns over low, mid and high sum to 1."""
        num_audio, num_columns = len(Features._fields), 1 if self.is_tied else self.num_levels
        f_id = f_id if self.has_style else jnp.ones_like(f_id[:, :1])
        scores = Linear(num_audio * num_columns, name="linear")(f_id)
        scores = scores.reshape(f_id.shape[0], num_audio, num_columns)
        may_count = jnp.array([name in self.audio_levels for name in Features._fields])[None, :, None]
        weights = nn.softmax(scores.astype(jnp.float32), axis=1, where=may_count).astype(scores.dtype)
        return jnp.broadcast_to(weights, (f_id.shape[0], num_audio, self.num_levels))


class HA2G(nn.Module):
    """Generator from speech audio, an identity and M seed poses to N poses on each level of the motion hierarchy:

        f_low, f_mid, f_high = E_a(audio)                encode_speech
        f_id ~ N(mean, s^2),  mean, log s^2 = E_ID       encode_identity
        f_a^h = sum_l C[l, h] f_l                        blend, Eq. 3
        p^h = stage h of (p^(h-1), f_a^h)                infer, Eq. 4

    Every method can be the `method=` of `apply`. Poses are flat, mean-subtracted direction vectors (D1).
    Only `encode_speech` and `encode_identity` use "batch_stats". In training `infer`, `encode_text` and, with
    `reads_words`, `encode_speech` draw from the stream "dropout".

    Attributes:
        audio: E_a, which maps one input, named by its `inputs`, to `Features`.
        text: E_t; its features serve the contrastive loss only, never the poses.
        level_channels: channels of the flat pose that each level h = 1..H holds (`Skeleton.level_channels`; an ablation
            may leave levels out, but not the last).
        audio_levels, is_tied: attributes of the style coordinator.
        has_coordinator: whether the identity determines the blend of the audio levels; otherwise the blend is the same
            for all and every stage also reads the identity, as a control of the coordinator.
        reads_words: whether f_t replaces f_high, an oracle that is told the words.
        noise_dim: channels of noise that every stage reads together with the audio; 0 in the paper, see
            `methods.energy_ha2g`.
    """

    audio: Any
    text: TextEncoder
    identity: ImageIdentity | SpeakerIdentity
    level_channels: tuple[tuple[int, ...], ...]
    audio_levels: tuple[str, ...] = Features._fields
    is_tied: bool = False
    has_coordinator: bool = True
    reads_words: bool = False
    num_seed_frames: int = 4
    hidden_dim: int = 300
    layers: int = 4
    dropout: float = 0.3
    noise_dim: int = 0

    def setup(self) -> None:
        self.coordinator = StyleCoordinator(
            len(self.level_channels), self.audio_levels, self.is_tied, self.has_coordinator
        )
        self.stages = [
            PoseStage(len(channels), self.hidden_dim, self.layers, self.dropout, name=f"pose_{level}")
            for level, channels in enumerate(self.level_channels, 1)
        ]

    def __call__(
        self, inputs: dict[str, jax.Array], identity: jax.Array, seed_pose: jax.Array, *, train: bool
    ) -> tuple[jax.Array, ...]:
        """Run every part once, with the mean for f_id; returns the poses of each level, as `infer`."""
        features = self.encode_speech(inputs, train=train)
        self.encode_text(inputs["words"], train=train)
        mean, _ = self.encode_identity(identity, train=train)
        noise = jnp.zeros((*features[0].shape[:2], self.noise_dim), features[0].dtype)
        return self.infer(features, mean, seed_pose, noise, train=train)

    def encode_speech(self, inputs: dict[str, jax.Array], *, train: bool) -> Features:
        """Map the spectrogram of windows, such as "mel" (B, 128, 70) in dB, to f_low, f_mid, f_high (B, N, 32)."""
        (name,) = self.audio.inputs
        features = self.audio(inputs[name], train=train)
        return features._replace(high=self.text(inputs["words"], train=train)) if self.reads_words else features

    def encode_text(self, words: jax.Array, *, train: bool) -> jax.Array:
        """Map word indices on frames (B, N) to f_t (B, N, 32)."""
        return self.text(words, train=train)

    def encode_identity(self, identity: jax.Array, *, train: bool) -> tuple[jax.Array, jax.Array]:
        """Map images (B, M, S, S, 3) or speaker indices (B,) to mean and log-variance of f_id, each (B, 18)."""
        return self.identity(identity, train=train)

    def coordinate(self, f_id: jax.Array) -> jax.Array:
        """Map f_id (B, 18) to the style coordinator C (B, 3, H)."""
        return self.coordinator(f_id)

    def blend(self, features: Features, f_id: jax.Array, noise: jax.Array | None = None) -> jax.Array:
        """Map the features, each (B, N, 32), to f_a (H, B, N, 32), one blend for each level of the motion (Eq. 3).

        After the 32 channels follow f_id (B, 18) if there is no coordinator, and the noise (B, N, noise_dim) if given.
        """
        blended = jnp.einsum("blh,blnf->hbnf", self.coordinate(f_id), jnp.stack(features, axis=1))
        others = [] if self.has_coordinator else [f_id[:, None]]
        others += [] if noise is None else [noise]
        return jnp.concatenate(
            [blended, *(jnp.broadcast_to(x, (*blended.shape[:3], x.shape[-1])) for x in others)], axis=-1
        )

    def infer(
        self,
        features: Features,
        f_id: jax.Array,
        seed_pose: jax.Array,
        noise: jax.Array | None = None,
        *,
        train: bool,
    ) -> tuple[jax.Array, ...]:
        """Infer poses, coarse to fine (Eq. 3 and 4).

        Stage h reads the seed pose in its frames, and p^(h-1) in the frames after it; p^0 is 0. D7: the seed pose has
        the channels of level h, so that all of it is read whatever levels an ablation leaves out; the channels that
        level h adds to level h - 1 are 0 after the seed pose.

        Args:
            features: f_low, f_mid, f_high, each (B, N, 32).
            f_id: (B, 18) identity, sampled or the mean.
            seed_pose: (B, M, pose_dim) true poses of the first M frames, mean-subtracted.
            noise: (B, N, noise_dim), None for a model without noise.

        Returns:
            For each level (B, N, d^h), mean-subtracted; the frames of the seed pose are predicted as well.
        """
        batch, num_frames = features[0].shape[:2]
        is_seed = jnp.broadcast_to(jnp.arange(num_frames)[:, None] < self.num_seed_frames, (batch, num_frames, 1))
        poses: list[jax.Array] = []
        known: tuple[int, ...] = ()  # channels of p^(h-1)
        for stage, channels, audio in zip(
            self.stages, self.level_channels, self.blend(features, f_id, noise), strict=True
        ):
            later = jnp.zeros((batch, num_frames - self.num_seed_frames, len(channels)), seed_pose.dtype)
            if known:  # a level has all channels of the one before
                shared = jnp.array([channels.index(channel) for channel in known])
                later = later.at[..., shared].set(poses[-1][:, self.num_seed_frames :], unique_indices=True)
            previous = jnp.concatenate([seed_pose[..., jnp.array(channels)], later], axis=1)
            poses.append(stage(previous, audio, is_seed.astype(seed_pose.dtype), train=train))
            known = channels
        return tuple(poses)
