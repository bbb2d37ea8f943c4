"""Import of TED-Expressive and TED-Gesture as they were published: LMDB databases, one for each split."""

import collections
import contextlib
import os
import pathlib
import struct
import sys
from collections.abc import Iterator
from concurrent.futures import Executor
from typing import Any, NamedTuple

import tqdm

from ha2g_jax.data import processes
from ha2g_jax.data.corpus import TRAIN
from ha2g_jax.data.corpus_writer import CorpusWriter
from ha2g_jax.data.recording import REASONS, Report, SplitReport, report_as_json
from ha2g_jax.errors import UserError, require
from ha2g_jax.files.reading import reading, shown
from ha2g_jax.importers.ted import arrow, clips
from ha2g_jax.progress import counted, progress_bar
from ha2g_jax.skeleton import SKELETONS, load_skeleton

_SPLITS = (TRAIN, "val", "test")
_NAMES = {"ted_expressive": "TED-Expressive", "ted_gesture": "TED-Gesture"}
_LICENCE = "TED talks: CC BY-NC-ND 4.0"

_FILE = "data.mdb"
_PAGE_HEADER = struct.Struct("<QHHHH")  # number, padding, flags, bounds of the free space
_META_FLAG = 0x08
_MAGIC, _VERSION = 0xBEEFC0DE, 1
_TREE = "IHHQQQQQ"  # padding (page size), flags, depth, numbers of pages of three kinds, entries, root
_META = struct.Struct(f"<IIQQ{_TREE}{_TREE}QQ")  # magic, version, address, map size, two trees, last page, transaction


class _Database(NamedTuple):
    """A database: its folder, its keys, and the number of joints of its first pose (None if there is no pose)."""

    folder: pathlib.Path
    keys: list[bytes]
    num_joints: int | None

    @property
    def path(self) -> str:
        return shown(self.folder / _FILE)


def import_ted(
    src: str | os.PathLike, dst: str | os.PathLike, *, split: str = TRAIN, workers: int | None = None
) -> Report:
    """Make a corpus of a TED data set; equal files give equal bytes, whatever the number of workers.

    Poses are resampled to 15 frames per second. Windows of 42 frames start every 10 frames; those that pass
    `recording.TED` are kept, and clips without a window are not written. Unusable clips are reported on stderr.

    Args:
        src: folder that contains `train`, `val` and `test`, or `lmdb_train` etc., or the folder of one database.
        split: name of the split if `src` is one database.

    Raises:
        UserError: there is no database or a damaged one, its joints are unknown, no window is left, or `dst` exists.
    """
    folders = _find_folders(pathlib.Path(src), split)
    _lmdb()
    for folder in folders.values():
        check_whole(folder)
    count = workers or os.cpu_count() or 1
    with processes.workers(count) as executor:
        databases = {}
        for split, folder in folders.items():
            [databases[split]] = processes.in_order(executor, _survey, [(folder,)], 1, _died(folder))
        skeleton = _find_skeleton(list(databases.values()))
        metadata = {
            "name": skeleton,
            "source": f"{_NAMES[skeleton]}, ha2g data import",
            "licence": _LICENCE,
            "files": {
                split: {"bytes": (database.folder / _FILE).stat().st_size, "videos": len(database.keys)}
                for split, database in databases.items()
            },
        }
        with CorpusWriter(dst, splits=list(databases), skeleton=skeleton, fps=clips.FPS, metadata=metadata) as writer:
            report = _write(writer, databases, skeleton, executor, count)
            if not any(counts.kept for counts in report.values()):
                raise UserError(f"{shown(src)} has no usable window ({_losses(report)}); give more data")
            writer.metadata["import"] = report_as_json(report)
    return report


def _find_folders(src: pathlib.Path, split: str) -> dict[str, pathlib.Path]:
    with reading(src, "a folder of TED-Expressive or TED-Gesture"):
        if (src / _FILE).exists():
            return {split: src}
    folders: dict[str, pathlib.Path] = {}
    for name in _SPLITS:
        found = [folder for folder in (src / name, src / f"lmdb_{name}") if folder.is_dir()]
        if len(found) > 1:
            raise UserError(
                f"{shown(src)} has both {found[0].name} and {found[1].name}; name the folder of one of them"
            )
        if found:
            folders[name] = found[0]
    if not folders:
        raise UserError(
            f"{shown(src)} has neither {_FILE} nor folders train, val, test or lmdb_train, lmdb_val, lmdb_test; "
            "name the folder of TED-Expressive or TED-Gesture"
        )
    return folders


def _find_skeleton(databases: list[_Database]) -> str:
    skeletons = {load_skeleton(name).num_joints: name for name in SKELETONS}
    found: dict[int, str] = {}
    for database in databases:
        if database.num_joints is not None:
            found.setdefault(database.num_joints, database.path)
    known = " or ".join(f"{count} ({_NAMES[name]})" for count, name in sorted(skeletons.items()))
    if not found:
        raise UserError(f"no poses in {databases[0].path} and its other splits; expected those of {known} joints")
    if len(found) > 1:
        places = " and ".join(f"{count} joints in {path}" for count, path in found.items())
        raise UserError(f"different skeletons: {places}; import each data set by itself")
    [(num_joints, path)] = found.items()
    if num_joints not in skeletons:
        raise UserError(f"{path} has poses of {num_joints} joints; expected {known}")
    return skeletons[num_joints]


def _died(path: str | os.PathLike) -> str:
    return (
        f"a process that read {shown(path)} died: the file is damaged (copy or download it again), "
        "or memory ran out (use fewer workers)"
    )


def _write(
    writer: CorpusWriter, databases: dict[str, _Database], skeleton: str, executor: Executor, count: int
) -> Report:
    report: Report = {}
    total = sum(len(database.keys) for database in databases.values())
    with progress_bar(f"importing {_NAMES[skeleton]}", total, "video") as bar:
        for split, database in databases.items():
            report[split] = SplitReport(filtered=collections.Counter(dict.fromkeys(REASONS, 0)))
            tasks = ((database.folder, key, skeleton) for key in database.keys)
            for video in processes.in_order(executor, _read_clips, tasks, count, _died(database.path)):
                for record in video.records:
                    writer.add(split, record)
                for line in video.damaged:
                    tqdm.tqdm.write(line, file=sys.stderr)
                report[split] += video.report
                bar.update()
    return report


def _losses(report: Report) -> str:
    total = sum(report.values(), SplitReport())
    reasons = [*total.filtered.items(), *total.rejected.items()]
    counts = ", ".join(f"{reason} {count}" for reason, count in reasons if count)
    return f"{counted(total.clips, 'clip')}, {counted(total.windows, 'window')}, left out: {counts or 'none'}"


def _survey(folder: pathlib.Path) -> _Database:
    """Return the keys of a database and the joints of its first pose; runs in a worker."""
    keys = read_keys(folder)
    counts = (clips.num_joints(*_video(folder, key)) for key in keys)
    return _Database(folder, keys, next((count for count in counts if count is not None), None))


def _read_clips(folder: pathlib.Path, key: bytes, skeleton: str) -> clips.VideoClips:
    """Return the clips of one video; runs in a worker."""
    video, name = _video(folder, key)
    return clips.read_clips(video, load_skeleton(skeleton), name)


def _video(folder: pathlib.Path, key: bytes) -> tuple[object, str]:
    name = f"{shown(folder / _FILE)}, record {key.decode('ascii', 'backslashreplace')[:40]}"
    return arrow.deserialize(read_value(folder, key), name), name


class _Meta(NamedTuple):
    page_size: int
    num_entries: int
    last_page: int
    transaction: int


def check_whole(folder: pathlib.Path) -> int:
    """Check that the file of a database is whole, because LMDB would read past its end, and return its record count.

    Raises:
        UserError: there is no such file, it is not an LMDB database, or it is shorter than it declares.
    """
    path = folder / _FILE
    try:
        if not path.is_file():
            raise UserError(f"{shown(folder)} has no {_FILE}; name a folder of an LMDB database")
        size = path.stat().st_size
        with path.open("rb") as file:
            first = _read_meta(file.read(_PAGE_HEADER.size + _META.size))
            if first is not None:
                file.seek(first.page_size)
            second = _read_meta(file.read(_PAGE_HEADER.size + _META.size))
    except OSError as error:
        raise UserError(f"{shown(path)} cannot be read ({error.strerror}); check its permissions") from error
    if first is None or second is None:
        raise UserError(f"{shown(path)} ({size} bytes) is not an LMDB database or damaged; copy or download it again")
    newest = max(first, second, key=lambda meta: meta.transaction)
    expected = (newest.last_page + 1) * newest.page_size
    if size < expected:
        raise UserError(f"{shown(path)} has {size} bytes instead of {expected}; copy or download it again")
    return newest.num_entries


def _read_meta(data: bytes) -> _Meta | None:
    """Read a meta page, None if the data are not a meta page."""
    if len(data) < _PAGE_HEADER.size + _META.size:
        return None
    _, _, flags, _, _ = _PAGE_HEADER.unpack_from(data)
    fields = _META.unpack_from(data, _PAGE_HEADER.size)
    page_size, num_entries = fields[4], fields[18]
    is_meta = flags & _META_FLAG and fields[0] == _MAGIC and fields[1] == _VERSION
    # LMDB allows these page sizes.
    if not is_meta or page_size not in (2**power for power in range(8, 17)):
        return None
    return _Meta(page_size, num_entries, last_page=fields[20], transaction=fields[21])


def read_keys(folder: pathlib.Path) -> list[bytes]:
    """Read all keys in order. Call it in a worker only: on a damaged file the C library may end the process.

    Raises:
        UserError: LMDB finds the file damaged.
    """
    keys: list[bytes] = []
    with _transaction(folder) as transaction:
        for key in transaction.cursor().iternext(keys=True, values=False):
            # Keys that do not ascend reveal damaged pages that refer to each other and would never end.
            if keys and bytes(key) <= keys[-1]:
                raise UserError(f"{shown(folder / _FILE)} is damaged (keys out of order); copy or download it again")
            keys.append(bytes(key))
    if len(keys) != (expected := check_whole(folder)):
        raise UserError(
            f"{shown(folder / _FILE)} is damaged ({len(keys)} of {expected} records); copy or download it again"
        )
    return keys


def read_value(folder: pathlib.Path, key: bytes) -> bytes:
    """Read the value of a key. Call it in a worker only: on a damaged file the C library may end the process.

    Raises:
        UserError: LMDB finds the file damaged.
    """
    with _transaction(folder) as transaction:
        value = transaction.get(key)
        if value is None or len(value) > (folder / _FILE).stat().st_size:
            raise UserError(f"{shown(folder / _FILE)} is damaged (record {key!r}); copy or download it again")
        return bytes(value)


@contextlib.contextmanager
def _transaction(folder: pathlib.Path) -> Iterator[Any]:
    lmdb = _lmdb()
    try:
        # The map has the size of the file; otherwise LMDB would map as much as the file declares.
        size = (folder / _FILE).stat().st_size
        with (
            # With read-ahead of the system, because values are large and sequential: 30 times as fast from a disk.
            lmdb.open(os.fsencode(folder), map_size=size, readonly=True, lock=False, create=False) as database,
            database.begin(buffers=True) as transaction,
        ):
            yield transaction
    except lmdb.Error as error:
        raise UserError(f"{shown(folder / _FILE)} is damaged ({error}); copy or download it again") from error


def _lmdb() -> Any:
    return require("lmdb", "import", by="the import of TED data")
