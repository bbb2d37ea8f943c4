"""Words with their times, from whatever people hold: files of many tools, a plain text, or the sound alone."""

from ha2g_jax.data.transcripts.beside import find
from ha2g_jax.data.transcripts.readers import read_words
from ha2g_jax.data.transcripts.source import words_of
from ha2g_jax.data.transcripts.timing import inside

__all__ = ["find", "inside", "read_words", "words_of"]
