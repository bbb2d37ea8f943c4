"""Generate motion from speech of any length with a trained model."""

from ha2g_jax.synthesis.files import generate_files
from ha2g_jax.synthesis.live import Stream
from ha2g_jax.synthesis.model import Model, encode_features, generate_directions, load
from ha2g_jax.synthesis.speech import Audio, read_speech
from ha2g_jax.synthesis.style import Style, choose_style, read_mixture

__all__ = [
    "Audio",
    "Model",
    "Stream",
    "Style",
    "choose_style",
    "encode_features",
    "generate_directions",
    "generate_files",
    "load",
    "read_mixture",
    "read_speech",
]
