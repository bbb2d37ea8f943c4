"""The weights of a model: model.safetensors and its hash, shapes by name, and tables of words."""

import hashlib
import pathlib
from typing import Any

import jax
import numpy as np
import safetensors
import safetensors.numpy
from flax import traverse_util

from ha2g_jax.errors import UserError
from ha2g_jax.features.text import PADDING, UNKNOWN, Vocabulary
from ha2g_jax.files.reading import file_sha256, shown
from ha2g_jax.files.tensors import open_tensors, read_tensor, shapes_of
from ha2g_jax.limits import MAX_HEADER_BYTES, MAX_WEIGHTS_BYTES

Shapes = dict[str, tuple[int, ...]]
TABLE = "/embedding/embedding"  # end of the name of a table of words or of speakers

_HALF_PRECISION_ABOVE = 20_000_000  # bytes of float32 weights; a package should not be larger
_MAX_HALF = 65504  # greatest number of float16


def write(path: pathlib.Path, variables: dict[str, Any], *, is_exact: bool = False) -> str:
    """Write variables as a file and return its hash: float32, or float16 if float32 would take more than 20 MB.

    Float32 arrays are written without a copy in memory. With `is_exact` all are float32.

    Raises:
        UserError: there are more weights than a model folder may have, or some are not finite.
        OSError: the file cannot be written.
    """
    arrays = _stored(variables, is_exact=is_exact)
    if (size := sum(array.nbytes for array in arrays.values())) > MAX_WEIGHTS_BYTES - MAX_HEADER_BYTES:
        raise UserError(
            f"the weights take {size} bytes, expected at most {MAX_WEIGHTS_BYTES - MAX_HEADER_BYTES}: use a smaller "
            "model"
        )
    if bad := next((name for name, array in arrays.items() if not np.isfinite(array).all()), None):
        raise UserError(f"{bad} of the weights has values that are not finite; choose another model")
    try:
        safetensors.numpy.save_file(arrays, path)
    except safetensors.SafetensorError as error:  # instead of an OSError, such as that of a full disk
        raise OSError(str(error)) from error
    return hash_of_file(path)


def hash_of(variables: dict[str, Any]) -> str:
    """Return the hash that the file of some variables would have."""
    return hashlib.sha256(safetensors.numpy.save(_stored(variables))).hexdigest()[:16]


def _stored(variables: dict[str, Any], *, is_exact: bool = False) -> dict[str, np.ndarray]:
    """Return variables by name in the type in which a file stores them."""
    flat = flatten(jax.tree.map(np.asarray, variables))
    is_small = sum(4 * array.size for array in flat.values()) <= _HALF_PRECISION_ABOVE
    if is_exact or is_small:
        return {name: np.ascontiguousarray(array, np.float32) for name, array in flat.items()}
    # Some arrays, such as variances, may have values beyond the range of float16.
    return {
        name: np.ascontiguousarray(array, np.float16 if np.abs(array).max(initial=0) <= _MAX_HALF else np.float32)
        for name, array in flat.items()
    }


def flatten(variables: Any) -> dict[str, Any]:
    """Return nested dicts as one dict, with names such as "params/audio/stem/kernel"."""
    return dict(traverse_util.flatten_dict(variables, sep="/"))


def hash_of_file(path: pathlib.Path) -> str:
    """Return the hash of a file of weights, without reading it into memory at once.

    Raises:
        UserError: the file is larger than that of any model.
    """
    if path.stat().st_size > MAX_WEIGHTS_BYTES:
        raise UserError(f"{shown(path)} has more than {MAX_WEIGHTS_BYTES} bytes, which is too large for a model")
    return file_sha256(path)[:16]


def read_shapes(path: pathlib.Path) -> Shapes:
    """Return the shape of each tensor by name, from the header of the file.

    Raises:
        UserError: the file is damaged.
    """
    with open_tensors(path) as file:
        return shapes_of(file)


def read(path: pathlib.Path) -> dict[str, Any]:
    """Return the variables in a file, float32 arrays, whose shapes were compared with those of the model.

    Raises:
        UserError: a tensor has another type than floating numbers, or values that are not finite.
    """
    with open_tensors(path) as file:
        flat = {name: read_tensor(file, name, path) for name in file.keys()}  # noqa: SIM118
    return {"params": {}, "batch_stats": {}} | traverse_util.unflatten_dict(flat, sep="/")


def compare(found: Shapes, expected: Shapes) -> str:
    """Describe in a few words how the tensors of a file differ from those of a model; return "" if they do not."""
    if odd := sorted(found.keys() ^ expected.keys()):
        verb = "is missing" if odd[0] in expected else "does not belong"
        return f"{odd[0]} {verb}" + (f" and {len(odd) - 1} more do not fit" if odd[1:] else "")
    for name, shape in expected.items():
        if found[name] != shape:
            return f"{name} has shape {found[name]} instead of {shape}"
    return ""


def is_word_table(name: str) -> bool:
    """Return whether a variable is a table of words; each level of a released model has its own."""
    return name.endswith(f"/text{TABLE}")


def in_vocabulary(table: np.ndarray, before: Vocabulary, after: Vocabulary) -> np.ndarray:
    """Return the rows of a table of words in the order of another vocabulary.

    The table (len(before) + n, D) has the vectors of the words of `before`, and of n marks at the end; the result
    (len(after) + n, D) has the vector of unknown words for each word that `before` lacks.
    """
    rows = [PADDING, UNKNOWN, *map(before.encode, after.words), *range(len(before), len(table))]
    return table[rows]
