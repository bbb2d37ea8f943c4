"""Tables of words in the weights of a model: their names, and their rows for another vocabulary."""

import numpy as np

from ha2g_jax.features.text import PADDING, UNKNOWN, Vocabulary

TABLE = "/embedding/embedding"  # end of the name of a table of words or of speakers


def is_word_table(name: str) -> bool:
    """Return whether a variable is a table of words; each level of a released model has one of its own."""
    return name.endswith(f"/text{TABLE}")


def in_vocabulary(table: np.ndarray, before: Vocabulary, after: Vocabulary) -> np.ndarray:
    """Return the rows of a table of words in the order of another vocabulary.

    Args:
        table: (len(before) + n, D) vectors of the words of `before`, and of n marks at the end.
        before: vocabulary of the table.
        after: vocabulary of the result.

    Returns:
        (len(after) + n, D) vectors; a word that `before` lacks has the vector of unknown words.
    """
    rows = [PADDING, UNKNOWN, *map(before.encode, after.words), *range(len(before), len(table))]
    return table[rows]
