"""Direction vectors in a bare array, as models of the TED data sets write them, whole or less the mean of the data.

An array says neither its frame rate, which is that of the TED data unless another is given, nor whether the mean
direction vectors of the data were subtracted. Unit lengths tell, before or after the mean is added. Outputs of networks
have no unit length; there, the vectors must also resemble the mean, or not resemble it.
"""

import pathlib

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import shown
from ha2g_jax.skeleton import SKELETONS, Skeleton, load_skeleton

FPS = 15.0  # frames per second of the TED data

_EXACT = 0.02  # median difference of the lengths from 1 that rounding explains
_MAX_ERROR = 0.35  # the same of outputs of networks
_MAX_VALUE = 1e3
_ALIKE, _UNLIKE = 0.7, 0.3  # fraction of the mean that direction vectors have, and residuals have not


def find_skeleton(array: np.ndarray) -> str | None:
    """Return the name of the skeleton whose direction vectors an array has by its shape, None without one."""
    for name in SKELETONS:
        bones = load_skeleton(name).num_bones
        if array.size and array.shape[1:] in ((3 * bones,), (bones, 3)):
            return name
    return None


def read_directions(array: np.ndarray, skeleton: Skeleton, path: pathlib.Path) -> tuple[np.ndarray, bool]:
    """Return the directions of an array.

    Args:
        array: (T, bones, 3) or (T, 3 * bones) direction vectors, or the same less `skeleton.mean_directions`.
        skeleton: skeleton of the bones.
        path: path of the file, for messages.

    Returns:
        (T, bones, 3) float64 vectors of any positive length, and whether the mean was added to them.

    Raises:
        UserError: the array has no numbers, or its lengths are those of neither.
    """
    if array.dtype.kind not in "fiu" or not (np.abs(array.astype(np.float64)) <= _MAX_VALUE).all():
        raise UserError(f"{shown(path)} holds values that are not numbers or are too large; expected direction vectors")
    whole = array.astype(np.float64).reshape(len(array), skeleton.num_bones, 3)
    added = whole + skeleton.mean_directions
    errors = [float(np.median(np.abs(np.linalg.norm(vectors, axis=-1) - 1))) for vectors in (whole, added)]
    mean = skeleton.mean_directions
    share = float(np.sum(whole.mean(axis=0) * mean) / np.sum(mean * mean))
    if errors[0] <= _EXACT or (errors[0] <= _MAX_ERROR and share >= _ALIKE):
        return whole, False
    if errors[1] <= _EXACT or (errors[1] <= _MAX_ERROR and share <= _UNLIKE):
        return added, True
    raise UserError(
        f"{shown(path)} has vectors whose lengths differ from 1 by {errors[0]:.2f}, and by {errors[1]:.2f} with the "
        f"mean of {skeleton.name} added; expected direction vectors, or the same less this mean: add what is missing"
    )
