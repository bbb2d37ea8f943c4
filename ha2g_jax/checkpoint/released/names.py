"""Names in a released file: words, speakers and the mean directions, which it holds as attributes of objects.

The description of the files does not name all attributes, so they are found by what they hold.
"""

import math
from typing import Any

import numpy as np

from ha2g_jax.files.torch_archive import Inert


def names_of(vocabulary: Any, first: int, count: int) -> list[str] | None:
    """Return the names of the rows of a table.

    Args:
        vocabulary: object with a mapping of indices to names, or of names to indices.
        first: index of the first name.
        count: number of names.

    Returns:
        The names by index, None if there is no mapping that has them all.
    """
    wanted = range(first, first + count)
    for mapping in _attributes(vocabulary).values():
        if not isinstance(mapping, dict):
            continue
        for names in (mapping, {value: key for key, value in mapping.items() if type(value) is int}):
            found = [names.get(index) for index in wanted]
            if all(isinstance(name, str) for name in found):
                return [str(name) for name in found]
    return None


def lower_case(words: list[str]) -> tuple[str, ...]:
    """Return words in lower case, as a `Vocabulary` looks for them; of two words that differ in case alone only one.

    Args:
        words: words by row; one that has to stay as it is, is never found, but keeps its row.
    """
    taken = set(words)
    made = []
    for word in words:
        lower = word.lower()
        made.append(word if lower in taken else lower)
        taken.add(made[-1])
    return tuple(made)


def mean_directions(settings: Any, num_bones: int) -> np.ndarray | None:
    """Return the mean direction vectors (bones, 3) in the settings of a released run.

    Args:
        settings: object with a list of 3 bones numbers, each of which may be a list of one.
        num_bones: bones of the skeleton.

    Returns:
        The vectors, None if there are none.
    """
    for values in _attributes(settings).values():
        if not isinstance(values, list) or len(values) != 3 * num_bones:
            continue
        flat = [value[0] if isinstance(value, list) and len(value) == 1 else value for value in values]
        if all(isinstance(value, float) and math.isfinite(value) for value in flat):
            return np.array(flat, np.float32).reshape(num_bones, 3)
    return None


def _attributes(value: Any) -> dict[Any, Any]:
    state = value.state if isinstance(value, Inert) else value
    return state if isinstance(state, dict) else {}
