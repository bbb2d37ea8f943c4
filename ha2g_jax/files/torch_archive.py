"""Safe reader of archives that `torch.save` of PyTorch 1.6 or later has written; it needs no PyTorch, and runs nothing.

An archive is a zip file without compression:

    NAME/data.pkl         a pickle of the value, with references to storages; `torch_pickle` follows it
    NAME/data/KEY         the numbers of a storage
    NAME/byteorder        "little" or "big", if it is there
    NAME/version and other small files, which are not needed

Nothing is unpacked to a disk, and the names in the zip file are compared and never used as paths. The numbers stay in
the file, which is mapped into memory: an array is a view of its bytes, so that a tensor takes memory only where it is
copied, and sizes that the file does not have cannot be asked for.
"""

import io
import math
import mmap
import os
import pathlib
import struct
import zipfile
import zlib
from typing import Any, NoReturn

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import reading, shown
from ha2g_jax.files.small_reads import SmallReads, read_exactly
from ha2g_jax.files.torch_pickle import Storage, read_pickle
from ha2g_jax.limits import MAX_TORCH_BYTES, MAX_TORCH_FILES, MAX_TORCH_PICKLE_BYTES

_EXPECTED = "an archive of weights of PyTorch (torch.save, 1.6 or later)"
_MAX_DIMENSIONS = 8
_BFLOAT16 = "BFloat16Storage"
_TYPES = {
    "FloatStorage": "<f4",
    "DoubleStorage": "<f8",
    "HalfStorage": "<f2",
    _BFLOAT16: "<u2",
    "LongStorage": "<i8",
    "IntStorage": "<i4",
    "ShortStorage": "<i2",
    "CharStorage": "i1",
    "ByteStorage": "u1",
    "BoolStorage": "?",
}
_LOCAL_HEADER = struct.Struct("<4s22xHH")  # signature, and the lengths of the name and of the extra field after it
_SIGNATURE = b"PK\x03\x04"


def read_torch(path: str | os.PathLike) -> Any:
    """Read the value in an archive of PyTorch.

    Args:
        path: path of the file.

    Returns:
        Plain values, containers, arrays in place of tensors, and `torch_pickle.Inert` in place of other objects; see
        `torch_pickle.read_pickle`. Arrays are views of the mapped file and cannot be written; the file must stay as it
        is while they are used.

    Raises:
        UserError: the file is missing, too large, damaged or of another kind, states sizes that its content does not
            have, has names that lead out of it, or asks for objects whose code would have to be run.
    """
    path = pathlib.Path(path)
    with reading(path, _EXPECTED, zipfile.BadZipFile, RuntimeError):
        size = path.stat().st_size
        if size > MAX_TORCH_BYTES:
            raise UserError(f"{shown(path)} has {size} bytes; expected at most {MAX_TORCH_BYTES}")
        with path.open("rb", buffering=0) as file, SmallReads(file) as reader:
            if reader.peek(2)[:1] == b"\x80":
                _refuse("it is a plain pickle, as PyTorch before 1.6 wrote; save it again with a later PyTorch")
            with zipfile.ZipFile(reader) as archive:
                return _Archive(archive, file, size).read()


class _Archive:
    """The files of a zip file whose names and sizes were checked."""

    def __init__(self, archive: zipfile.ZipFile, file: io.FileIO, size: int):
        self._archive = archive
        self._entries = _check_entries(archive.infolist(), size)
        # The views of it keep the map open.
        self._bytes = np.frombuffer(mmap.mmap(file.fileno(), size, access=mmap.ACCESS_READ), np.uint8)
        self._arrays: dict[str, np.ndarray] = {}

    def read(self) -> Any:
        """Return the value of the pickle."""
        pickles = [name for name in self._entries if name.endswith("/data.pkl")]
        if len(pickles) != 1:
            _refuse(f"it has {len(pickles)} files named data.pkl instead of one")
        self._folder = pickles[0].removesuffix("data.pkl")
        if self._folder.count("/") != 1 or f"{self._folder}constants.pkl" in self._entries:
            _refuse("it is a program of TorchScript, or has its files in other folders")
        order = f"{self._folder}byteorder"
        if order in self._entries and self._content(order, 16) != b"little":
            _refuse("its numbers are not in little-endian order")
        return read_pickle(bytes(self._content(pickles[0], MAX_TORCH_PICKLE_BYTES)), self._tensor)

    def _content(self, name: str, most: int) -> memoryview:
        entry = self._entries[name]
        if entry.file_size > most:
            _refuse(f"its {name[-40:]} has {entry.file_size} bytes instead of at most {most}")
        with self._archive.open(entry) as file:
            content = read_exactly(file, entry.file_size)
            file.read(1)  # zipfile compares the checksum at the end
        return content

    def _tensor(self, storage: Storage, offset: int, shape: tuple[int, ...], strides: tuple[int, ...]) -> np.ndarray:
        numbers = self._numbers(storage)
        count = math.prod(shape)
        last = offset + sum((length - 1) * stride for length, stride in zip(shape, strides, strict=True))
        # The second term refuses views that repeat numbers, which could be larger than the file.
        if len(shape) > _MAX_DIMENSIONS or (count and (last >= numbers.size or count > numbers.size)):
            _refuse(f"a tensor of shape {_short(shape)} in {numbers.size} numbers")
        if not count:
            return np.zeros(shape, numbers.dtype)
        steps = [stride * numbers.itemsize for stride in strides]
        view = np.lib.stride_tricks.as_strided(numbers[offset:], shape, steps, writeable=False)
        if storage.kind == _BFLOAT16:
            return (view.astype(np.uint32) << 16).view(np.float32)
        return view

    def _numbers(self, storage: Storage) -> np.ndarray:
        if storage.kind not in _TYPES:
            _refuse(f"numbers of the type {storage.kind[:40]!r}")
        dtype = np.dtype(_TYPES[storage.kind])
        name = f"{self._folder}data/{storage.key}"
        if name not in self._entries:
            _refuse(f"the numbers {storage.key[:40]!r} are missing")
        if storage.count * dtype.itemsize != self._entries[name].file_size:
            _refuse(
                f"the numbers {storage.key[:40]!r} take {self._entries[name].file_size} bytes, and not "
                f"{dtype.itemsize} times {storage.count}"
            )
        if name not in self._arrays:
            self._arrays[name] = self._mapped(self._entries[name])
        return self._arrays[name].view(dtype)

    def _mapped(self, entry: zipfile.ZipInfo) -> np.ndarray:
        """Return the bytes of a file that is stored without compression, after a check of its checksum."""
        header = self._bytes[max(entry.header_offset, 0) :][: _LOCAL_HEADER.size].tobytes()
        if len(header) < _LOCAL_HEADER.size or not header.startswith(_SIGNATURE):
            raise EOFError("it ends early")
        _, name_length, extra_length = _LOCAL_HEADER.unpack(header)
        start = entry.header_offset + _LOCAL_HEADER.size + name_length + extra_length
        content = self._bytes[start : start + entry.file_size]
        if len(content) < entry.file_size:
            raise EOFError("it ends early")
        if zlib.crc32(content.data) != entry.CRC:
            _refuse(f"bad checksum of {entry.filename[-40:]!r}")
        return content


def _check_entries(infos: list[zipfile.ZipInfo], size: int) -> dict[str, zipfile.ZipInfo]:
    """Return the files of a zip file by name, after a check of names, sizes and forms."""
    if len(infos) > MAX_TORCH_FILES:
        _refuse(f"it has {len(infos)} files instead of at most {MAX_TORCH_FILES}")
    entries: dict[str, zipfile.ZipInfo] = {}
    for info in infos:
        name = info.orig_filename
        if name.startswith("/") or ":" in name or "\\" in name or "\0" in name or ".." in name.split("/"):
            _refuse(f"it has a file {name[:60]!r}, whose name leads out of it")
        if name in entries:
            _refuse(f"it has {name[:60]!r} twice")
        if info.flag_bits & 0x1 or info.compress_type != zipfile.ZIP_STORED or info.compress_size != info.file_size:
            _refuse(f"{name[:60]!r} is encrypted or compressed")
        entries[name] = info
    if sum(info.file_size for info in infos) > size:
        _refuse("its files are larger than itself")
    return entries


def _refuse(reason: str) -> NoReturn:
    raise zipfile.BadZipFile(reason)


def _short(shape: tuple[int, ...]) -> str:
    return str(shape)[:60]
