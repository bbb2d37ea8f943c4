"""Reader of untrusted safetensors files: the header is checked before any tensor is read."""

import contextlib
import os
import pathlib
import struct
from collections.abc import Iterator
from typing import Any

import numpy as np
import safetensors

from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import check_there, reason, shown
from ha2g_jax.limits import MAX_HEADER_BYTES

TYPES = ("F32", "F16", "BF16")  # types of tensors that are read


@contextlib.contextmanager
def open_tensors(path: str | os.PathLike) -> Iterator[Any]:
    """Open a file of tensors with `safetensors.safe_open`; each tensor stays on the disk until it is read.

    The library checks the header, whose size is limited here: names, types and shapes fit the bytes that follow, which
    they cover without gaps and overlaps.

    Raises:
        UserError: the file is missing, unreadable, not there yet or damaged, or its header is too large.
    """
    check_there(path)
    try:
        _check_header_size(pathlib.Path(path))
        with safetensors.safe_open(path, "numpy") as file:
            yield file
    except FileNotFoundError:
        raise UserError(f"no file {shown(path)}; download the model again") from None
    except OSError as error:
        raise UserError(
            f"cannot read {shown(path)} ({reason(error).lower()}); expected a file of safetensors"
        ) from error
    except (safetensors.SafetensorError, ValueError) as error:
        raise UserError(f"{shown(path)} is damaged ({reason(error)}); download it again") from error


def _check_header_size(path: pathlib.Path) -> None:
    with path.open("rb") as file:
        start = file.read(8)
    if len(start) == 8 and struct.unpack("<Q", start)[0] > MAX_HEADER_BYTES:
        raise ValueError(f"its header has more than {MAX_HEADER_BYTES} bytes")


def shapes_of(file: Any) -> dict[str, tuple[int, ...]]:
    """Return the shape of each tensor of an open file by name, using only the header."""
    names = file.keys()
    return {name: tuple(file.get_slice(name).get_shape()) for name in names}


def read_tensor(file: Any, name: str, path: str | os.PathLike) -> np.ndarray:
    """Read a tensor of a file that `open_tensors` has opened as float32.

    Raises:
        UserError: the tensor has another type than floating numbers of 16 or 32 bits, or values that are not finite.
    """
    dtype = file.get_slice(name).get_dtype()
    if dtype not in TYPES:
        raise UserError(
            f"{shown(path)} has {name} as {dtype}, expected one of {', '.join(TYPES)}: "
            "choose a model that is not quantised"
        )
    tensor = file.get_tensor(name).astype(np.float32)
    if not np.isfinite(tensor).all():
        raise UserError(f"{shown(path)} has values in {name} that are not finite; choose another model")
    return tensor
