"""Safe reader of untrusted `.npz` and `.npy` files, without pickle and with checks of all sizes."""

import io
import math
import os
import pathlib
import re
import struct
import zipfile
import zlib
from collections.abc import Collection
from typing import IO

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import SmallReads, check_there, read_exactly, reason, shown
from ha2g_jax.limits import MAX_NPZ_OF_ANY_RATIO, MAX_NPZ_RATIO

_MAGIC = b"\x93NUMPY"
_MAX_HEADER = 1 << 16

_DESCR = re.compile(rb"'descr':\s*'([^']*)'")
_FORTRAN = re.compile(rb"'fortran_order':\s*(True|False)")
_SHAPE = re.compile(rb"'shape':\s*\(([0-9, ]*)\)")
_PLAIN = re.compile(r"[<>|=]?[biufSU][0-9]{1,9}")


def read_npz(
    path: str | os.PathLike, *, max_bytes: int = 1 << 30, names: Collection[str] | None = None
) -> dict[str, np.ndarray]:
    """Read the arrays of a file that `numpy.savez`, `savez_compressed` or `save` wrote.

    Sizes are taken from the table of contents and the headers of the arrays, and checked before anything is unpacked.

    Args:
        path: path of a `.npz` file, or of a `.npy` file, whose array has the file's stem as its name.
        max_bytes: maximum size of all arrays together.
        names: names of the arrays to read if they exist, None for all; others are neither read nor checked.

    Returns:
        Arrays of numbers or text by name, in native byte order.

    Raises:
        UserError: the file is missing, empty, damaged, too large when unpacked, a zip bomb, encrypted, or has an array
            of Python objects, which only pickle could read.
    """
    path = pathlib.Path(path)
    check_there(path)
    try:
        opened = path.open("rb", buffering=0)
    except FileNotFoundError:
        raise UserError(f"no file at {shown(path)}; expected a .npz of arrays") from None
    except (OSError, ValueError) as error:  # ValueError: a null character in the path
        raise UserError(f"cannot read {shown(path)} ({reason(error).lower()}); expected a .npz of arrays") from error
    try:
        with opened as file, SmallReads(file) as reader:
            size = os.fstat(file.fileno()).st_size
            if reader.peek(len(_MAGIC))[: len(_MAGIC)] != _MAGIC:
                return _read_zip(reader, size, max_bytes, names)
            is_wanted = names is None or path.stem in names
            return {path.stem: _read_array(reader, size, max_bytes)} if is_wanted else {}
    except _BadArrays as error:
        raise UserError(
            f"{shown(path)} cannot be used: {error}; expected a .npz of plain arrays (numpy.savez)"
        ) from error
    # zipfile and zlib raise different exceptions depending on the position of the damage.
    except (zipfile.BadZipFile, zlib.error, struct.error, EOFError, OSError, RuntimeError, ValueError) as error:
        raise UserError(
            f"{shown(path)} is not a whole .npz file ({reason(error)}); copy or download it again"
        ) from error
    except MemoryError as error:
        raise UserError(f"{shown(path)} needs more memory than there is; give a smaller file") from error


class _BadArrays(Exception):
    """Error for a complete file with unusable arrays."""


def _read_zip(
    reader: io.BufferedReader, size: int, max_bytes: int, names: Collection[str] | None
) -> dict[str, np.ndarray]:
    with zipfile.ZipFile(reader) as archive:
        entries: dict[str, zipfile.ZipInfo] = {}
        for entry in archive.infolist():
            name = entry.filename.removesuffix(".npy")
            if names is None or name in names:
                _check_entry(entry, name, name in entries)
                entries[name] = entry
        total = sum(entry.file_size for entry in entries.values())
        if total > max_bytes:
            raise _BadArrays(f"it unpacks to {total} bytes, more than the {max_bytes} allowed")
        if total > max(MAX_NPZ_OF_ANY_RATIO, MAX_NPZ_RATIO * size):
            raise _BadArrays(f"its {size} bytes unpack to {total}, more than {MAX_NPZ_RATIO} times as many")
        arrays = {}
        for name, entry in entries.items():
            with archive.open(entry) as file:
                try:
                    arrays[name] = _read_array(file, entry.file_size, max_bytes)
                except _BadArrays as error:
                    raise _BadArrays(f"array {name[:100]!r}: {error}") from error
        return arrays


def _check_entry(entry: zipfile.ZipInfo, name: str, is_second: bool) -> None:
    shown = repr(entry.filename[:100])
    if not entry.filename.endswith(".npy") or not name or "/" in name or "\\" in name:
        raise _BadArrays(f"it has {shown}, which is not an array")
    if is_second:
        raise _BadArrays(f"it has {shown} twice")
    if entry.flag_bits & 0x1:
        raise _BadArrays(f"{shown} is encrypted")
    # Other methods need as much memory as the file declares.
    if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise _BadArrays(f"{shown} is compressed by a method that numpy does not use")


def _read_array(file: IO[bytes], size: int, max_bytes: int) -> np.ndarray:
    """Read the array of a `.npy` of `size` bytes, which must match its shape exactly."""
    start = file.read(8)
    if start[:6] != _MAGIC or len(start) < 8:
        raise _BadArrays("it is not in numpy's format")
    length_format = "<H" if start[6] == 1 else "<I"
    length_bytes = file.read(struct.calcsize(length_format))
    (length,) = struct.unpack(length_format, length_bytes)
    if length > _MAX_HEADER:
        raise _BadArrays(f"a header of {length} bytes")
    dtype, shape, is_fortran = _parse_header(file.read(length))
    num_bytes = math.prod(shape) * dtype.itemsize
    found = size - len(start) - len(length_bytes) - length
    if num_bytes != found:
        raise _BadArrays(f"shape {shape} of {dtype} needs {num_bytes} bytes, but it has {found}")
    if num_bytes > max_bytes:
        raise _BadArrays(f"it unpacks to {num_bytes} bytes, more than the {max_bytes} allowed")
    data = read_exactly(file, num_bytes)
    file.read(1)  # zipfile compares the checksum at the end
    if num_bytes == 0:
        return np.zeros(shape, dtype.newbyteorder("="))
    array = np.frombuffer(data, dtype).reshape(shape, order="F" if is_fortran else "C")
    array = array.astype(dtype.newbyteorder("="), copy=False)
    if dtype.kind == "U" and array.ravel("K").view(np.uint32).max() > 0x10FFFF:
        raise _BadArrays("text that is not Unicode")
    return array


def _parse_header(header: bytes) -> tuple[np.dtype, tuple[int, ...], bool]:
    """Parse type, shape and order by regular expressions, so that nothing is evaluated."""
    descr, fortran, shape = (pattern.search(header) for pattern in (_DESCR, _FORTRAN, _SHAPE))
    if fortran is None or shape is None:
        raise _BadArrays("a header without shape")
    name = descr.group(1).decode("latin-1") if descr else "structured"
    if "O" in name:
        raise _BadArrays("it holds Python objects (pickle), which are not safe to read; save it as plain numbers")
    try:
        dtype = np.dtype(name) if _PLAIN.fullmatch(name) else None
    except (TypeError, ValueError):
        dtype = None
    if dtype is None or dtype.itemsize == 0:
        raise _BadArrays(f"elements of type {name[:40]!r} instead of numbers or text")
    lengths = [field.strip() for field in shape.group(1).split(b",") if field.strip()]
    if len(lengths) > 32 or any(not field.isdigit() or len(field) > 18 for field in lengths):
        raise _BadArrays(f"the shape ({shape.group(1)[:100].decode()})")
    return dtype, tuple(map(int, lengths)), fortran.group(1) == b"True"
