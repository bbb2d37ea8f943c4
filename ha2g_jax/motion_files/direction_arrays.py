"""Direction vectors in a bare array, as models of the TED data sets write them, whole or less the mean of the data.

An array says neither its frame rate, which is that of the TED data unless another is given, nor whether the mean
direction vectors of the data were subtracted. The lengths tell: those of direction vectors are near 1, and those of
residuals become so when the mean is added.
"""

import pathlib

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import shown
from ha2g_jax.skeleton import SKELETONS, Skeleton, load_skeleton

FPS = 15.0  # frames per second of the TED data

_MAX_ERROR = 0.35  # median difference of the lengths from 1; outputs of networks are no unit vectors
_CLEARER = 2.0  # how many times nearer to 1 the lengths must be one way than the other


def find_skeleton(array: np.ndarray) -> str | None:
    """Return the name of the skeleton whose direction vectors an array has by its shape, None without one."""
    for name in SKELETONS:
        bones = load_skeleton(name).num_bones
        if len(array) and array.shape[1:] in ((3 * bones,), (bones, 3)):
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
    if array.dtype.kind != "f" or not np.isfinite(array).all():
        raise UserError(f"{shown(path)} holds values that are no finite numbers; expected direction vectors")
    whole = array.astype(np.float64).reshape(len(array), skeleton.num_bones, 3)
    added = whole + skeleton.mean_directions
    errors = [float(np.median(np.abs(np.linalg.norm(vectors, axis=-1) - 1))) for vectors in (whole, added)]
    nearer = int(np.argmin(errors))
    if errors[nearer] > _MAX_ERROR or max(errors) < _CLEARER * errors[nearer]:
        raise UserError(
            f"{shown(path)} has vectors whose lengths differ from 1 by {errors[0]:.2f}, and by {errors[1]:.2f} with the "
            f"mean of {skeleton.name} added; expected direction vectors, or the same less this mean: add the mean that "
            "was subtracted"
        )
    return (whole, added)[nearer], nearer == 1
