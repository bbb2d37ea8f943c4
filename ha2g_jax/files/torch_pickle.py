"""Reader of the pickle in an archive of PyTorch that runs nothing: it follows the opcodes, and knows few of them.

A pickle is a program for a stack machine. Of its opcodes only those are followed that make plain values, containers and
tensors; no name in it is ever imported or called. What the files of the field hold besides is accepted as `Inert`: the
name of a class, with the state of the object, if there is one, as plain values. These are objects that are made without
arguments, such as the settings of a program, and arrays of NumPy, whose numbers are not read. A request to call
anything else is an error.
"""

import dataclasses
import pickletools
from collections.abc import Callable
from typing import Any

from ha2g_jax.limits import MAX_TORCH_OPCODES

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


class RefusedError(ValueError):
    """Error for a pickle that is damaged, or asks for more than plain values and tensors."""


@dataclasses.dataclass(frozen=True)
class Storage:
    """The numbers that tensors are views of.

    Attributes:
        kind: name of the class, such as "FloatStorage".
        key: name of the file in the archive.
        count: number of numbers, as the pickle states it.
    """

    kind: str
    key: str
    count: int


@dataclasses.dataclass
class Inert:
    """An object that was not made.

    Attributes:
        name: name of its class or function with its module.
        state: attributes of an object that is made without arguments; None for all others.
    """

    name: str
    state: Any = None


@dataclasses.dataclass(frozen=True)
class _Name:
    """Name of something in a Python module, which is not looked up."""

    module: str
    name: str

    def __str__(self) -> str:
        return f"{self.module}.{self.name}"[:100]


# A function of a storage, an offset, a shape and strides, in numbers, to a tensor.
MakeTensor = Callable[[Storage, int, tuple[int, ...], tuple[int, ...]], Any]


def read_pickle(data: bytes, make_tensor: MakeTensor) -> Any:
    """Return the value of a pickle of protocol 2 to 5.

    Args:
        data: the pickle.
        make_tensor: function that makes the tensors.

    Returns:
        None, bool, int, float, str, bytes, list, tuple, dict with keys of text or whole numbers, what `make_tensor`
        returns, and `Inert`. Containers may contain themselves.

    Raises:
        RefusedError: the pickle is damaged, too long, or asks for anything else.
    """
    machine = _Machine(make_tensor)
    try:
        for opcode, argument, _ in pickletools.genops(data):
            machine.step(opcode.name, argument)
    except RefusedError:
        raise
    # The stack is empty, or holds other values than the opcode needs; `genops` raises ValueError for damage.
    except (ValueError, IndexError, KeyError, TypeError, AttributeError, OverflowError) as error:
        raise RefusedError(f"its pickle is damaged: {error}") from error
    return machine.result()


class _Machine:
    """The stack and the memo of a pickle."""

    def __init__(self, make_tensor: MakeTensor):
        self._stack: list[Any] = []
        self._memo: dict[int, Any] = {}
        self._make_tensor = make_tensor
        self._count = 0

    def result(self) -> Any:
        """Return the value after the last opcode."""
        (value,) = self._stack
        return _plain(value)

    def step(self, name: str, argument: Any) -> None:
        """Follow one opcode.

        Args:
            name: name of the opcode in `pickletools`.
            argument: its argument, None without one.
        """
        stack = self._stack
        self._count += 1
        if self._count > MAX_TORCH_OPCODES:
            raise RefusedError(f"its pickle has more than {MAX_TORCH_OPCODES} opcodes")
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
            raise RefusedError(f"its pickle has the opcode {name}, which files of weights do not need")

    def _pop(self, kind: type | None = None) -> Any:
        value = self._stack.pop()
        if value is _MARK or (kind is not None and not isinstance(value, kind)):
            raise RefusedError("its pickle is damaged: a value of the wrong kind")
        return value

    def _items(self) -> list[Any]:
        """Take the values down to the last mark."""
        place = len(self._stack) - 1
        while self._stack[place] is not _MARK:  # an IndexError if there is none
            place -= 1
            if place < 0:
                raise RefusedError("its pickle is damaged: no mark")
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
        raise RefusedError(f"its pickle asks to call {called}, which is never done")

    def _tensor(self, storage: Any, offset: Any, shape: Any, strides: Any) -> Any:
        if not (isinstance(storage, Storage) and isinstance(shape, tuple) and isinstance(strides, tuple)):
            raise RefusedError("its pickle is damaged: a tensor without a storage")
        if len(shape) != len(strides) or not all(type(it) is int and it >= 0 for it in (offset, *shape, *strides)):
            raise RefusedError("its pickle is damaged: a tensor with an impossible shape")
        return self._make_tensor(storage, offset, shape, strides)

    def _object(self) -> Inert:
        arguments, made = self._pop(tuple), self._pop(_Name)
        if arguments:
            raise RefusedError(f"its pickle asks to make {made} with arguments, which is never done")
        return Inert(str(made))

    def _storage(self) -> Storage:
        what, kind, key, _, count = self._pop(tuple)
        if what != "storage" or not isinstance(kind, _Name) or type(key) is not str or type(count) is not int:
            raise RefusedError("its pickle is damaged: a persistent value that is no storage")
        if kind.module != "torch":
            raise RefusedError(f"its pickle has a storage of {kind}, expected one of torch")
        return Storage(kind.name, key, count)

    def _build(self) -> None:
        state, built = self._pop(), self._stack[-1]
        # A mapping of weights has the versions of its layers as attributes; an array has its numbers.
        if isinstance(built, Inert) and isinstance(state, dict) and built.state is None:
            built.state = state
        elif not isinstance(built, Inert | dict):
            raise RefusedError("its pickle gives attributes to a value that has none")

    def _append(self, values: list[Any]) -> None:
        target = self._stack[-1]
        if not isinstance(target, list):
            raise RefusedError("its pickle is damaged: items without a list")
        target.extend(map(_plain, values))

    def _set(self, values: list[Any]) -> None:
        target = self._stack[-1]
        if not isinstance(target, dict) or len(values) % 2:
            raise RefusedError("its pickle is damaged: items without a mapping")
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
    """Return a value that a container may hold: names of modules are none."""
    if isinstance(value, _Name | Storage) or value is _MARK:
        raise RefusedError(f"its pickle refers to {value}, which is never looked up")
    return value


def _key(value: Any) -> Any:
    if type(value) is str or (type(value) is int and abs(value) < _MAX_KEY):
        return value
    raise RefusedError("its pickle has a mapping with keys other than text and whole numbers")
