"""Words with their times, from transcripts of many formats, from a plain text, or from the audio alone."""

from ha2g_jax.features.words.lookup import find
from ha2g_jax.features.words.readers import read_words
from ha2g_jax.features.words.timing import inside
from ha2g_jax.features.words.words import words_of

__all__ = ["find", "inside", "read_words", "words_of"]
