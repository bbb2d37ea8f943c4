"""The weights of a model in model.safetensors, and their hash."""

import hashlib
import pathlib
from typing import Any

import jax
import numpy as np
import safetensors.numpy
from flax import traverse_util

from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import shown
from ha2g_jax.files.tensors import open_tensors, read_tensor, shapes_of
from ha2g_jax.limits import MAX_WEIGHTS_BYTES

Shapes = dict[str, tuple[int, ...]]

_HALF_PRECISION_ABOVE = 20_000_000  # bytes of float32 weights; a package should not be larger


def to_bytes(variables: dict[str, Any], *, is_exact: bool = False) -> bytes:
    """Return variables as the content of a file: float32, or float16 if float32 would take more than 20 MB.

    Args:
        variables: {"params", "batch_stats"} of the generator.
        is_exact: whether to store float32 whatever the size.

    Raises:
        UserError: there are more weights than a model folder may have.
    """
    flat = flatten(jax.tree.map(np.asarray, variables))
    is_small = sum(4 * array.size for array in flat.values()) <= _HALF_PRECISION_ABOVE
    dtype = np.float32 if is_exact or is_small else np.float16
    data = safetensors.numpy.save({name: np.ascontiguousarray(array, dtype) for name, array in flat.items()})
    if len(data) > MAX_WEIGHTS_BYTES:
        raise UserError(
            f"the weights take {len(data)} bytes, expected at most {MAX_WEIGHTS_BYTES}: use a smaller model"
        )
    return data


def flatten(variables: Any) -> dict[str, Any]:
    """Return nested dicts as one dict, with names such as "params/audio/stem/kernel"."""
    return dict(traverse_util.flatten_dict(variables, sep="/"))


def hash_of(data: bytes) -> str:
    """Return the hash of the content of a file of weights."""
    return hashlib.sha256(data).hexdigest()[:16]


def hash_of_file(path: pathlib.Path) -> str:
    """Return the hash of a file of weights, without reading it into memory at once.

    Args:
        path: path of the file.

    Raises:
        UserError: the file is larger than that of any model.
    """
    if path.stat().st_size > MAX_WEIGHTS_BYTES:
        raise UserError(f"{shown(path)} has more than {MAX_WEIGHTS_BYTES} bytes, which is too large for a model")
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()[:16]


def read_shapes(path: pathlib.Path) -> Shapes:
    """Return the shape of each tensor by name, from the header of the file.

    Args:
        path: path of the file.

    Raises:
        UserError: the file is damaged.
    """
    with open_tensors(path) as file:
        return shapes_of(file)


def read(path: pathlib.Path) -> dict[str, Any]:
    """Return the variables in a file whose shapes were compared with those of the model.

    Args:
        path: path of the file.

    Returns:
        {"params", "batch_stats"} as float32 arrays.

    Raises:
        UserError: a tensor has another type than floating numbers, or values that are not finite.
    """
    with open_tensors(path) as file:
        names = file.keys()
        flat = {name: read_tensor(file, name, path) for name in names}
    return {"params": {}, "batch_stats": {}} | traverse_util.unflatten_dict(flat, sep="/")


def compare(found: Shapes, expected: Shapes) -> str:
    """Describe in a few words how the tensors of a file differ from those of a model; return "" if they do not.

    Args:
        found: shapes in the file, by name.
        expected: shapes of the model, by name.
    """
    if odd := sorted(found.keys() ^ expected.keys()):
        verb = "is missing" if odd[0] in expected else "does not belong"
        return f"{odd[0]} {verb}" + (f" and {len(odd) - 1} more do not fit" if odd[1:] else "")
    for name, shape in expected.items():
        if found[name] != shape:
            return f"{name} has shape {found[name]} instead of {shape}"
    return ""
