"""Writes what the importer reads: values as `pyarrow.serialize` of pyarrow 0.14 lays them out, and LMDB databases."""

import pathlib
import struct
from collections.abc import Callable
from typing import Any, NamedTuple

import lmdb
import numpy as np
import pytest

from ha2g_jax.skeleton import load_skeleton

_INT, _FLOAT, _BINARY, _TEXT, _BOOL, _LIST, _STRUCT, _UNION = 2, 3, 4, 5, 6, 12, 13, 14
_KINDS = {bool: 0, int: 1, bytes: 3, str: 4, np.float16: 5, np.float32: 6, float: 7, list: 9, dict: 10, tuple: 11}
_NUMBERS = {1: "<i8", 5: "<f2", 6: "<f4", 7: "<f8"}
_ARRAY = 14
_PRECISIONS = {2: 0, 4: 1, 8: 2}


@pytest.fixture(scope="session")
def serialize() -> Callable[[Any], bytes]:
    """A Python value -> its bytes."""
    return _serialize


@pytest.fixture(scope="session")
def write_database() -> Callable[..., pathlib.Path]:
    """(folder, values) -> the folder, now an LMDB database with the keys 0000000000, 0000000001, ..."""
    return _write_database


@pytest.fixture(scope="session")
def make_video() -> Callable[..., dict[str, Any]]:
    """(id, number of clips, joints, seed) -> a video of a person who waves and says twelve words in each clip."""
    return _make_video


def _write_database(folder: pathlib.Path, values: list[Any]) -> pathlib.Path:
    with lmdb.open(str(folder), map_size=1 << 26, lock=False) as database, database.begin(write=True) as transaction:
        for index, value in enumerate(values):
            transaction.put(f"{index:010d}".encode(), value if isinstance(value, bytes) else _serialize(value))
    return folder


def _make_video(vid: str, clips: int = 1, joints: int = 10, seed: int = 0) -> dict[str, Any]:
    skeleton = load_skeleton("ted_expressive" if joints == 43 else "ted_gesture")
    rng = np.random.default_rng(seed)
    made = []
    for clip in range(clips):
        start, frames, fps = 10.0 * (clip + 1), 100, 25.0
        poses = skeleton.mean_pose + np.zeros((frames, 1, 1), np.float32)
        poses[:, 1:] *= 1.2
        poses[:, skeleton.joint("left_wrist"), 1] += 0.2 * np.sin(np.arange(frames) / 8)
        times = start + np.arange(12) / 3
        made.append(
            {
                "words": [["word", float(time), float(time) + 0.25] for time in times],
                "skeletons_3d": list(poses) if clip % 2 == 0 else poses,
                "audio_feat": np.zeros((128, 126), np.float16),
                "audio_raw": (0.1 * rng.standard_normal(round(16000 * frames / fps))).astype(np.float16),
                "start_frame_no": round(start * fps),
                "end_frame_no": round(start * fps) + frames,
                "start_time": start,
                "end_time": start + frames / fps,
            }
        )
    return {"vid": vid, "clips": made}


class _Writer:
    """Collects the arrays of a record batch and the numpy arrays of a value."""

    def __init__(self) -> None:
        self.nodes: list[tuple[int, int]] = []
        self.places: list[tuple[int, int]] = []
        self.body = b""
        self.arrays: list[np.ndarray] = []

    def union(self, name: str, items: list[Any]) -> "_Flat":
        """Adds a dense union of the items; returns its field."""
        groups: dict[int, list[Any]] = {}
        rows = []
        for item in items:
            group = groups.setdefault(_kind(item), []) if item is not None else None
            rows.append((list(groups).index(_kind(item)), len(group)) if group is not None else (0, 0))
            if group is not None:
                group.append(item)
        is_valid = [item is not None for item in items]
        self._node(len(items), len(items) - sum(is_valid))
        self._buffer(b"" if all(is_valid) else np.packbits(is_valid, bitorder="little").tobytes())
        self._buffer(np.array([kind for kind, _ in rows], "i1").tobytes())
        self._buffer(np.array([row for _, row in rows], "<i4").tobytes())
        children = [self._child(kind, group) for kind, group in groups.items()]
        return _field(name, _UNION, _table(("h", 1), None), children)

    def _child(self, kind: int, items: list[Any]) -> "_Flat":
        name = str(kind)
        self._node(len(items), 0)
        self._buffer(b"")
        if kind == _KINDS[bool]:
            self._buffer(np.packbits(items, bitorder="little").tobytes())
            return _field(name, _BOOL, _table(), [])
        if kind in _NUMBERS:
            self._buffer(np.array(items, _NUMBERS[kind]).tobytes())
            return _field(name, *_number_type(np.dtype(_NUMBERS[kind])), [])
        if kind == _ARRAY:
            indices = range(len(self.arrays), len(self.arrays) + len(items))
            self.arrays += items
            self._buffer(np.array(indices, "<i4").tobytes())
            return _field(name, *_number_type(np.dtype("<i4")), [])
        ends = np.cumsum([0, *(len(item.encode() if isinstance(item, str) else item) for item in items)])
        self._buffer(ends.astype("<i4").tobytes())
        if kind in (_KINDS[str], _KINDS[bytes]):
            self._buffer(b"".join(item.encode() if isinstance(item, str) else item for item in items))
            return _field(name, _TEXT if kind == _KINDS[str] else _BINARY, _table(), [])
        if kind != _KINDS[dict]:
            return _field(name, _LIST, _table(), [self.union("item", [value for item in items for value in item])])
        self._node(int(ends[-1]), 0)
        self._buffer(b"")
        pairs = [pair for item in items for pair in item.items()]
        children = [self.union("keys", [key for key, _ in pairs]), self.union("vals", [value for _, value in pairs])]
        return _field(name, _LIST, _table(), [_field("item", _STRUCT, _table(), children)])

    def _node(self, length: int, nulls: int) -> None:
        self.nodes.append((length, nulls))

    def _buffer(self, data: bytes) -> None:
        self.places.append((len(self.body), len(data)))
        self.body += _padded(data, 8)


def _serialize(value: Any) -> bytes:
    writer = _Writer()
    schema = _table(("h", 0), _tables([writer.union("list", [value])]))
    batch = _table(("q", 1), _numbers("2q", writer.nodes), _numbers("2q", writer.places))
    data = struct.pack("<4i", 0, len(writer.arrays), 0, 0)
    data += _message(1, schema, b"", 8) + _message(3, batch, writer.body, 8) + bytes(4)
    for array in writer.arrays:
        sizes = _tables([_table(("q", size)) for size in array.shape])
        strides = _numbers("q", [(stride,) for stride in array.strides])
        kind, type = _number_type(array.dtype)
        tensor = _table(("B", kind), type, sizes, strides, ("2q", 0, array.nbytes))
        data = _padded(data, 64) + _message(4, tensor, array.tobytes("A"), 64)
    return _padded(data, 64)


class _Flat(NamedTuple):
    """A piece of flatbuffers, which is to start at a multiple of 8 bytes, and where in it offsets to it point."""

    data: bytes
    entry: int


def _table(*fields: "tuple | _Flat | None") -> _Flat:
    """A vtable, its table, and what that points to. A number is (format, value, ...), a default None."""
    vtable: list[int] = []
    inline = bytearray(4)
    targets: list[tuple[int, _Flat]] = []
    for field in fields:
        size = struct.calcsize(field[0][-1]) if field is not None and not isinstance(field, _Flat) else 4
        inline += bytes(-len(inline) % size)
        vtable.append(0 if field is None else len(inline))
        if isinstance(field, _Flat):
            targets.append((len(inline), field))
            inline += bytes(4)
        elif field is not None:
            inline += struct.pack("<" + field[0], *field[1:])
    sizes = struct.pack(f"<{2 + len(vtable)}H", 4 + 2 * len(vtable), len(inline), *vtable)
    head = bytes(-len(sizes) % 8) + sizes
    struct.pack_into("<i", inline, 0, len(sizes))
    places = [(len(head) + place, target) for place, target in targets]
    return _append(bytearray(head + inline), places, len(head))


def _tables(tables: list[_Flat]) -> _Flat:
    """A vector of tables."""
    data = bytearray(struct.pack("<I", len(tables)) + bytes(4 * len(tables)))
    return _append(data, [(4 + 4 * index, table) for index, table in enumerate(tables)], 0)


def _numbers(format: str, items: list[tuple[int, ...]]) -> _Flat:
    """A vector of numbers, or of structs of them."""
    return _Flat(struct.pack("<4xI", len(items)) + b"".join(struct.pack("<" + format, *item) for item in items), 4)


def _append(data: bytearray, targets: list[tuple[int, _Flat]], entry: int) -> _Flat:
    for place, target in targets:
        data += bytes(-len(data) % 8)
        struct.pack_into("<I", data, place, len(data) + target.entry - place)
        data += target.data
    return _Flat(bytes(data), entry)


def _field(name: str, kind: int, type: _Flat, children: list[_Flat]) -> _Flat:
    text = name.encode()
    letters = _Flat(struct.pack("<I", len(text)) + text + bytes(1), 0)
    return _table(letters, ("B", 1), ("B", kind), type, None, _tables(children))


def _number_type(dtype: np.dtype) -> tuple[int, _Flat]:
    if dtype.kind == "f":
        return _FLOAT, _table(("h", _PRECISIONS[dtype.itemsize]))
    return _INT, _table(("i", 8 * dtype.itemsize), ("B", int(dtype.kind == "i")))


def _message(kind: int, header: _Flat, body: bytes, alignment: int) -> bytes:
    table = _table(("h", 3), ("B", kind), header, ("q", len(body)))
    metadata = _padded(bytes(4) + struct.pack("<I4x", 8 + table.entry) + table.data, alignment)[4:]
    return struct.pack("<i", len(metadata)) + metadata + body


def _kind(item: Any) -> int:
    return _ARRAY if isinstance(item, np.ndarray) else _KINDS[type(item)]


def _padded(data: bytes, alignment: int) -> bytes:
    return data + bytes(-len(data) % alignment)
