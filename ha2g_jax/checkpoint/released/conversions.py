"""Conversions of tensors from the layouts of PyTorch to those of our modules."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

FIRST_WORD, FIRST_SPEAKER = 4, 1  # rows of the released tables; before them are marks, and a row that was never trained
_UNKNOWN = 3  # row of unknown words
_Shape = tuple[int, ...]


class Conversion(NamedTuple):
    """How a tensor of a released file becomes one of ours.

    Attributes:
        convert: function of the array in the file.
        stored: function of the shape of our array to that in the file.
    """

    convert: Callable[[np.ndarray], np.ndarray]
    stored: Callable[[_Shape], _Shape]


def _kernel(array: np.ndarray) -> np.ndarray:
    return np.moveaxis(array, (0, 1), (-1, -2))


def _stored_kernel(shape: _Shape) -> _Shape:
    return shape[-1], shape[-2], *shape[:-2]


def _words(table: np.ndarray) -> np.ndarray:
    return np.concatenate([table[:1], table[_UNKNOWN:]])


SAME = Conversion(lambda array: array, lambda shape: shape)
# (outputs, inputs, *space) of a linear map or a convolution becomes (*space, inputs, outputs).
KERNEL = Conversion(_kernel, _stored_kernel)
# (inputs, outputs, K) of a transposed convolution, the gradient of a correlation, becomes (K, inputs, outputs).
TRANSPOSED = Conversion(lambda array: np.moveaxis(array, 2, 0)[::-1], lambda shape: (shape[1], shape[2], shape[0]))
# (outputs, 1, 1), the norms of a weight-normalised convolution.
NORMS = Conversion(np.ravel, lambda shape: (*shape, 1, 1))
# The rows are padding, start, end, unknown and the words; ours padding, unknown and the words.
WORDS = Conversion(_words, lambda shape: (shape[0] + FIRST_WORD - 2, *shape[1:]))
# Row 0 belongs to no speaker.
SPEAKERS = Conversion(lambda table: table[FIRST_SPEAKER:], lambda shape: (shape[0] + FIRST_SPEAKER, *shape[1:]))
