"""Linen modules: they declare the parameters; the mathematics is plain functions on arrays."""

from ha2g_jax.models.asr_audio import AsrAudioEncoder
from ha2g_jax.models.autoencoder import LATENT_DIMS, PoseAutoencoder
from ha2g_jax.models.discriminator import Discriminator
from ha2g_jax.models.ha2g import HA2G, PoseStage
from ha2g_jax.models.identity import ImageIdentity, SpeakerIdentity
from ha2g_jax.models.resnet_se import AudioEncoder, Features
from ha2g_jax.models.tcn import RECEPTIVE_FIELDS, TextEncoder
from ha2g_jax.models.whisper import WhisperEncoder

__all__ = [
    "HA2G",
    "LATENT_DIMS",
    "RECEPTIVE_FIELDS",
    "AsrAudioEncoder",
    "AudioEncoder",
    "Discriminator",
    "Features",
    "ImageIdentity",
    "PoseAutoencoder",
    "PoseStage",
    "SpeakerIdentity",
    "TextEncoder",
    "WhisperEncoder",
]
