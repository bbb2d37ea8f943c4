"""Encoders that several methods have in common, from a config."""

import jax

from ha2g_jax.config.choices import choice
from ha2g_jax.config.settings import Config
from ha2g_jax.errors import UserError
from ha2g_jax.layers.identity import SpeakerIdentity
from ha2g_jax.layers.tcn import RECEPTIVE_FIELDS, TextEncoder
from ha2g_jax.layers.waveform import WaveformEncoder
from ha2g_jax.methods.method import Spec, Variables


def text_encoder(config: Config, vocabulary_size: int) -> TextEncoder:
    """Return E_t, as wide as the features of the audio.

    Raises:
        UserError: an unknown receptive field.
    """
    text = config.model.text
    return TextEncoder(
        vocabulary_size=vocabulary_size,
        embedding_dim=text.embedding_dim,
        channels=text.channels,
        layers=text.layers,
        feature_dim=config.model.audio.feature_dim,
        receptive_field=choice("model.text.receptive_field", text.receptive_field, RECEPTIVE_FIELDS),
        dropout=text.dropout,
    )


def waveform_encoder(config: Config) -> WaveformEncoder:
    """Return the encoder of the samples of a window."""
    data = config.data
    return WaveformEncoder(config.model.audio.feature_dim, num_frames=data.num_frames, fps=data.fps)


def speaker_table(config: Config, num_speakers: int, *, has_hidden: bool = False) -> SpeakerIdentity:
    """Return a table of the speakers; where windows are mirrored it has as many rows again for their mirror images."""
    return SpeakerIdentity(
        num_speakers=2 * num_speakers if config.data.mirror else num_speakers,
        feature_dim=config.model.identity.feature_dim,
        has_hidden=has_hidden,
    )


def no_identity(spec: Spec, variables: Variables, identity: jax.Array) -> jax.Array:
    """Refuse an identity: the `encode_identity` of a method without one.

    Raises:
        UserError: always.
    """
    del variables, identity
    raise UserError(f"{spec.method} knows no speakers; leave the style out")
