"""A trained model and speech of any length to motion (SPEC: inference)."""

from ha2g_jax.synthesis.files import generate_files
from ha2g_jax.synthesis.model import Model, encode_features, generate_directions, load
from ha2g_jax.synthesis.style import choose_style, read_mixture

__all__ = ["Model", "choose_style", "encode_features", "generate_directions", "generate_files", "load", "read_mixture"]
