"""Safe reader of archives that `torch.save` of PyTorch 1.6 or later wrote; it needs no PyTorch and executes nothing.

An archive is a zip file without compression:

    NAME/data.pkl         a pickle of the value, with references to storages
    NAME/data/KEY         the numbers of a storage
    NAME/byteorder        "little" or "big", if it is there
    NAME/version and other small files, which are not needed

Nothing is unpacked to a disk, and the names in the zip file are compared and never used as paths. The numbers stay in
the file, which is mapped into memory: an array is a view of its bytes, so that a tensor takes memory only when it is
copied, and cannot be larger than the file.

A pickle is a program for a stack machine. Only the opcodes that make plain values, containers and tensors are executed;
no name in it is ever imported or called. Other objects that such files commonly hold become `Inert`: the name of a
class, with the state of the object, if there is one, as plain values. These are objects that are made without
arguments, such as the settings of a program, and arrays of NumPy, whose numbers are not read. A request to call
anything else is an error.
"""

import dataclasses
import io
import math
import mmap
import os
import pathlib
import pickletools
import struct
import zipfile
import zlib
from collections.abc import Callable
from typing import Any

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import SmallReads, read_exactly, reading, shown
from ha2g_jax.limits import MAX_TORCH_BYTES, MAX_TORCH_FILES, MAX_TORCH_OPCODES, MAX_TORCH_PICKLE_BYTES

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

_MAPPINGS = {("collections", "OrderedDict"), ("collections", "Counter")}
_DEFAULTDICT = ("collections", "defaultdict")
_SETS = {(module, name) for module in ("builtins", "__builtin__") for name in ("set", "frozenset")}
# Callables whose results stay inert, whatever their arguments.
_INERT = {
    ("_codecs", "encode"),
    ("numpy", "dtype"),
    ("numpy.core.multiarray", "_reconstruct"),
    ("numpy.core.multiarray", "scalar"),
    ("numpy._core.multiarray", "_reconstruct"),
    ("numpy._core.multiarray", "scalar"),
    ("torch", "device"),
}
_TENSOR, _PARAMETER = ("torch._utils", "_rebuild_tensor_v2"), ("torch._utils", "_rebuild_parameter")

_NUMBERS = ("BININT", "BININT1", "BININT2", "LONG1", "LONG4", "BINFLOAT")
_TEXTS = ("BINUNICODE", "SHORT_BINUNICODE", "BINUNICODE8", "BINSTRING", "SHORT_BINSTRING")
_BYTES = ("BINBYTES", "SHORT_BINBYTES", "BINBYTES8")
_VALUES = frozenset(("NONE", "NEWTRUE", "NEWFALSE", *_NUMBERS, *_TEXTS, *_BYTES))
_CONSTANTS = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False}
_MARK = object()
_MAX_KEY = 2**31


@dataclasses.dataclass
class Inert:
    """A description of an object that was not created.

    Attributes:
        name: name of its class or function with its module.
        state: attributes of an object that is made without arguments; None for all others.
    """

    name: str
    state: Any = None


def read_torch(path: str | os.PathLike) -> Any:
    """Read the value in an archive of PyTorch.

    Returns:
        None, bool, int, float, str, bytes, list, tuple, dict with keys of text or whole numbers, arrays instead of
        tensors, and `Inert` instead of other objects. Containers may contain themselves. Arrays are views of the mapped
        file and cannot be written; the file must not change while they are used.

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
                raise _Refused("it is a plain pickle, as PyTorch before 1.6 wrote; save it again with a later PyTorch")
            with zipfile.ZipFile(reader) as archive:
                return _Archive(archive, file, size).read()


class _Refused(ValueError):
    """Error for an archive that is damaged, or asks for more than plain values and tensors."""


@dataclasses.dataclass(frozen=True)
class _Storage:
    """The numbers that tensors are views of."""

    kind: str  # name of the class, such as "FloatStorage"
    key: str  # name of the file in the archive
    count: int  # as the pickle states it


@dataclasses.dataclass(frozen=True)
class _Name:
    """Name of something in a Python module, which is not looked up."""

    module: str
    name: str

    def __str__(self) -> str:
        return f"{self.module}.{self.name}"[:100]


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
            raise _Refused(f"it has {len(pickles)} files named data.pkl instead of one")
        self._folder = pickles[0].removesuffix("data.pkl")
        if self._folder.count("/") != 1 or f"{self._folder}constants.pkl" in self._entries:
            raise _Refused("it is a program of TorchScript, or has its files in other folders")
        order = f"{self._folder}byteorder"
        if order in self._entries and self._content(order, 16) != b"little":
            raise _Refused("its numbers are not in little-endian order")
        return _read_pickle(bytes(self._content(pickles[0], MAX_TORCH_PICKLE_BYTES)), self._tensor)

    def _content(self, name: str, most: int) -> memoryview:
        entry = self._entries[name]
        if entry.file_size > most:
            raise _Refused(f"its {name[-40:]} has {entry.file_size} bytes instead of at most {most}")
        with self._archive.open(entry) as file:
            content = read_exactly(file, entry.file_size)
            file.read(1)  # zipfile compares the checksum at the end
        return content

    def _tensor(self, storage: _Storage, offset: int, shape: tuple[int, ...], strides: tuple[int, ...]) -> np.ndarray:
        numbers = self._numbers(storage)
        count = math.prod(shape)
        last = offset + sum((length - 1) * stride for length, stride in zip(shape, strides, strict=True))
        # The second term refuses views that repeat numbers, which could be larger than the file.
        if len(shape) > _MAX_DIMENSIONS or (count and (last >= numbers.size or count > numbers.size)):
            raise _Refused(f"a tensor of shape {str(shape)[:60]} in {numbers.size} numbers")
        steps = [stride * numbers.itemsize for stride in strides]
        view = (
            np.lib.stride_tricks.as_strided(numbers[offset:], shape, steps, writeable=False) if count else numbers[:0]
        )
        if storage.kind == _BFLOAT16:
            view = np.asarray(view.astype(np.uint32) << 16).view(np.float32)
        return view.reshape(shape)

    def _numbers(self, storage: _Storage) -> np.ndarray:
        if storage.kind not in _TYPES:
            raise _Refused(f"numbers of the type {storage.kind[:40]!r}")
        dtype = np.dtype(_TYPES[storage.kind])
        name = f"{self._folder}data/{storage.key}"
        if name not in self._entries:
            raise _Refused(f"the numbers {storage.key[:40]!r} are missing")
        if storage.count * dtype.itemsize != self._entries[name].file_size:
            raise _Refused(
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
            raise _Refused(f"bad checksum of {entry.filename[-40:]!r}")
        return content


def _check_entries(infos: list[zipfile.ZipInfo], size: int) -> dict[str, zipfile.ZipInfo]:
    """Return the files of a zip file by name, after a check of names, sizes and forms."""
    if len(infos) > MAX_TORCH_FILES:
        raise _Refused(f"it has {len(infos)} files instead of at most {MAX_TORCH_FILES}")
    entries: dict[str, zipfile.ZipInfo] = {}
    for info in infos:
        name = info.orig_filename
        if name.startswith("/") or ":" in name or "\\" in name or "\0" in name or ".." in name.split("/"):
            raise _Refused(f"it has a file {name[:60]!r}, whose name leads out of it")
        if name in entries:
            raise _Refused(f"it has {name[:60]!r} twice")
        if info.flag_bits & 0x1 or info.compress_type != zipfile.ZIP_STORED or info.compress_size != info.file_size:
            raise _Refused(f"{name[:60]!r} is encrypted or compressed")
        entries[name] = info
    if sum(info.file_size for info in infos) > size:
        raise _Refused("its files are larger than itself")
    return entries


# A function of a storage, an offset, a shape and strides, in numbers, to a tensor.
_MakeTensor = Callable[[_Storage, int, tuple[int, ...], tuple[int, ...]], Any]


def _read_pickle(data: bytes, make_tensor: _MakeTensor) -> Any:
    """Return the value of a pickle of protocol 2 to 5."""
    machine = _Machine(make_tensor)
    try:
        for opcode, argument, _ in pickletools.genops(data):
            machine.step(opcode.name, argument)
    except _Refused:
        raise
    # The stack is empty, or holds other values than the opcode needs; `genops` raises ValueError for damage.
    except (ValueError, IndexError, KeyError, TypeError, AttributeError, OverflowError) as error:
        raise _Refused(f"its pickle is damaged: {error}") from error
    return machine.result()


class _Machine:
    """The stack and the memo of a pickle."""

    def __init__(self, make_tensor: _MakeTensor):
        self._stack: list[Any] = []
        self._memo: dict[int, Any] = {}
        self._make_tensor = make_tensor
        self._count = 0

    def result(self) -> Any:
        """Return the value after the last opcode."""
        (value,) = self._stack
        return _plain(value)

    def step(self, name: str, argument: Any) -> None:
        """Execute one opcode; the names are those of `pickletools`."""
        stack = self._stack
        self._count += 1
        if self._count > MAX_TORCH_OPCODES:
            raise _Refused(f"its pickle has more than {MAX_TORCH_OPCODES} opcodes")
        if name in _VALUES:
            stack.append(_CONSTANTS.get(name, argument))
        elif name in ("PROTO", "FRAME", "STOP"):
            pass
        elif name in ("BINPUT", "LONG_BINPUT"):
            self._memo[argument] = stack[-1]
        elif name == "MEMOIZE":
            self._memo[len(self._memo)] = stack[-1]
        elif name in ("BINGET", "LONG_BINGET"):
            stack.append(self._memo[argument])
        elif name == "MARK":
            stack.append(_MARK)
        elif name in _MAKERS:
            stack.append(_MAKERS[name](self))
        elif name in _CHANGES:
            _CHANGES[name](self)
        elif name == "GLOBAL":
            module, _, name = argument.partition(" ")
            stack.append(_Name(module, name))
        else:
            raise _Refused(f"its pickle has the opcode {name}, which files of weights do not need")

    def _pop(self, kind: type | None = None) -> Any:
        value = self._stack.pop()
        if value is _MARK or (kind is not None and not isinstance(value, kind)):
            raise _Refused("its pickle is damaged: a value of the wrong kind")
        return value

    def _items(self) -> list[Any]:
        """Take the values down to the last mark."""
        place = len(self._stack) - 1
        while self._stack[place] is not _MARK:  # an IndexError if there is none
            place -= 1
            if place < 0:
                raise _Refused("its pickle is damaged: no mark")
        items = self._stack[place + 1 :]
        del self._stack[place:]
        return items

    def _tuple_of(self, count: int) -> tuple[Any, ...]:
        return tuple(reversed([self._pop() for _ in range(count)]))

    def _name(self) -> _Name:
        name, module = self._pop(str), self._pop(str)
        return _Name(module, name)

    def _call(self) -> Any:
        arguments, called = self._pop(tuple), self._pop(_Name)
        which = (called.module, called.name)
        if which in _MAPPINGS:
            pairs = arguments[0] if arguments else {}
            pairs = pairs.items() if isinstance(pairs, dict) else pairs
            return {_key(key): _plain(value) for key, value in pairs}
        if which == _DEFAULTDICT:
            return {}
        if which in _SETS:
            return list(map(_plain, arguments[0] if arguments else ()))
        if which == _TENSOR:
            return self._tensor(*arguments[:4])
        if which == _PARAMETER:
            return arguments[0]
        if which in _INERT:
            return Inert(str(called))
        raise _Refused(f"its pickle asks to call {called}, which is never done")

    def _tensor(self, storage: Any, offset: Any, shape: Any, strides: Any) -> Any:
        if not (isinstance(storage, _Storage) and isinstance(shape, tuple) and isinstance(strides, tuple)):
            raise _Refused("its pickle is damaged: a tensor without a storage")
        if len(shape) != len(strides) or not all(type(it) is int and it >= 0 for it in (offset, *shape, *strides)):
            raise _Refused("its pickle is damaged: a tensor with an impossible shape")
        return self._make_tensor(storage, offset, shape, strides)

    def _object(self) -> Inert:
        arguments, made = self._pop(tuple), self._pop(_Name)
        if arguments:
            raise _Refused(f"its pickle asks to make {made} with arguments, which is never done")
        return Inert(str(made))

    def _storage(self) -> _Storage:
        what, kind, key, _, count = self._pop(tuple)
        if what != "storage" or not isinstance(kind, _Name) or type(key) is not str or type(count) is not int:
            raise _Refused("its pickle is damaged: a persistent value that is no storage")
        if kind.module != "torch":
            raise _Refused(f"its pickle has a storage of {kind}, expected one of torch")
        return _Storage(kind.name, key, count)

    def _build(self) -> None:
        state, built = self._pop(), self._stack[-1]
        # A mapping of weights has the versions of its layers as attributes; an array has its numbers.
        if isinstance(built, Inert) and isinstance(state, dict) and built.state is None:
            built.state = state
        elif not isinstance(built, Inert | dict):
            raise _Refused("its pickle gives attributes to a value that has none")

    def _append(self, values: list[Any]) -> None:
        target = self._stack[-1]
        if not isinstance(target, list):
            raise _Refused("its pickle is damaged: items without a list")
        target.extend(map(_plain, values))

    def _set(self, values: list[Any]) -> None:
        target = self._stack[-1]
        if not isinstance(target, dict) or len(values) % 2:
            raise _Refused("its pickle is damaged: items without a mapping")
        target.update({_key(key): _plain(value) for key, value in zip(values[::2], values[1::2], strict=True)})


_MAKERS: dict[str, Callable[[_Machine], Any]] = {
    "EMPTY_DICT": lambda machine: {},
    "EMPTY_LIST": lambda machine: [],
    "EMPTY_TUPLE": lambda machine: (),
    "TUPLE": lambda machine: tuple(machine._items()),
    "TUPLE1": lambda machine: machine._tuple_of(1),
    "TUPLE2": lambda machine: machine._tuple_of(2),
    "TUPLE3": lambda machine: machine._tuple_of(3),
    "STACK_GLOBAL": _Machine._name,
    "REDUCE": _Machine._call,
    "NEWOBJ": _Machine._object,
    "BINPERSID": _Machine._storage,
}
_CHANGES: dict[str, Callable[[_Machine], None]] = {
    "BUILD": _Machine._build,
    "APPEND": lambda machine: machine._append([machine._pop()]),
    "APPENDS": lambda machine: machine._append(machine._items()),
    "SETITEM": lambda machine: machine._set(list(machine._tuple_of(2))),
    "SETITEMS": lambda machine: machine._set(machine._items()),
}


def _plain(value: Any) -> Any:
    """Return a value that a container may hold; names in modules are refused."""
    if isinstance(value, _Name | _Storage) or value is _MARK:
        raise _Refused(f"its pickle refers to {value}, which is never looked up")
    return value


def _key(value: Any) -> Any:
    if type(value) is str or (type(value) is int and abs(value) < _MAX_KEY):
        return value
    raise _Refused("its pickle has a mapping with keys other than text and whole numbers")
