"""Words with their times, from transcripts of many formats, from a plain text, or from the audio alone."""

from ha2g_jax.features.words.timing import inside
from ha2g_jax.features.words.transcripts import find, read_words, words_of

__all__ = ["find", "inside", "read_words", "words_of"]
