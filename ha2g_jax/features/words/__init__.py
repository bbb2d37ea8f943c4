"""Words with their times, from transcripts of many formats, from a plain text, or from the audio alone."""

from ha2g_jax.features.words.timing import inside, split_words
from ha2g_jax.features.words.transcripts import find, parse_words, read_words, split_speaker, words_of

__all__ = ["find", "inside", "parse_words", "read_words", "split_speaker", "split_words", "words_of"]
