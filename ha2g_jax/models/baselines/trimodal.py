"""Trimodal (Yoon et al. 2020): speech, its words and the speaker to poses."""

import jax
import jax.numpy as jnp
from flax import linen as nn

from ha2g_jax.models.baselines.frame_decoder import FrameDecoder
from ha2g_jax.models.baselines.waveform import WaveformEncoder
from ha2g_jax.models.identity import SpeakerIdentity
from ha2g_jax.models.tcn import TextEncoder


class Trimodal(nn.Module):
    """Speech audio, its words, a speaker and M seed poses to N poses.

    Every method can be the `method=` of `apply`. Poses are flat, mean-subtracted direction vectors (D1). Only
    `listen` uses "batch_stats"; it and `infer` draw from the stream "dropout" in training.

    Attributes:
        audio: encoder of the samples.
        text: encoder of the words on frames.
        identity: the table of speakers.
        pose_dim: values of a flat pose.
        hidden_dim, layers, dropout: of the GRU.
    """

    audio: WaveformEncoder
    text: TextEncoder
    identity: SpeakerIdentity
    pose_dim: int
    hidden_dim: int = 300
    layers: int = 4
    dropout: float = 0.3

    inputs = ("audio", "words")

    def setup(self) -> None:
        self.decoder = FrameDecoder(self.pose_dim, self.hidden_dim, self.layers, self.dropout)

    @property
    def style_dim(self) -> int:
        """Values of the style z."""
        return self.identity.feature_dim

    def __call__(
        self, inputs: dict[str, jax.Array], identity: jax.Array, seed: jax.Array, *, train: bool
    ) -> tuple[jax.Array, ...]:
        """Runs every part once, with the mean for the style; returns the poses, as `infer`."""
        mean, _ = self.encode_identity(identity, train=train)
        return self.infer(self.listen(inputs, train=train), mean, seed, train=train)

    def listen(self, inputs: dict[str, jax.Array], *, train: bool) -> jax.Array:
        """Maps "audio" (B, 36267) and "words" (B, N) to the features of both, (B, N, 32 + 32)."""
        audio, text = self.audio(inputs["audio"], train=train), self.text(inputs["words"], train=train)
        return jnp.concatenate([audio, text], axis=-1)

    def encode_identity(self, speaker: jax.Array, *, train: bool) -> tuple[jax.Array, jax.Array]:
        """Maps speaker indices (B,) to mean and log-variance of z, each (B, style_dim)."""
        return self.identity(speaker, train=train)

    def infer(self, heard: jax.Array, style: jax.Array, seed: jax.Array, *, train: bool) -> tuple[jax.Array, ...]:
        """Every frame sees its seed pose or zeros, a bit that marks seeds, the speech and the style.

        Args:
            heard: (B, N, features) of `listen`.
            style: (B, style_dim), z.
            seed: (B, M, pose_dim) true poses of the first M frames, mean-subtracted.

        Returns:
            One level, (B, N, pose_dim), mean-subtracted, the seed frames predicted as well.
        """
        (batch, num_frames), num_seed_frames = heard.shape[:2], seed.shape[1]
        marked = jnp.concatenate([seed, jnp.ones_like(seed[..., :1])], axis=-1)
        known = jnp.pad(marked, ((0, 0), (0, num_frames - num_seed_frames), (0, 0)))
        styles = jnp.broadcast_to(style[:, None], (batch, num_frames, style.shape[-1]))
        return (self.decoder(jnp.concatenate([known, heard, styles], axis=-1), train=train),)
