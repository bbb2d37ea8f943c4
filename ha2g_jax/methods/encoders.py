"""Encoders that several methods have in common, from a config."""

from ha2g_jax.config import Config
from ha2g_jax.layers.identity import SpeakerIdentity
from ha2g_jax.layers.tcn import RECEPTIVE_FIELDS, TextEncoder
from ha2g_jax.methods.choices import choice


def text_encoder(config: Config, vocabulary_size: int) -> TextEncoder:
    """E_t, as wide as the features of the audio.

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


def speaker_table(config: Config, num_speakers: int, *, has_hidden: bool = False) -> SpeakerIdentity:
    """A table of the speakers; where windows are mirrored it has as many rows again for their mirror images."""
    return SpeakerIdentity(
        num_speakers=2 * num_speakers if config.data.mirror else num_speakers,
        feature_dim=config.model.identity.feature_dim,
        has_hidden=has_hidden,
    )
