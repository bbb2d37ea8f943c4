"""A corpus on disk: ArrayRecord shards of clips and one `dataset.json` with the statistics of the training split."""

import bisect
import collections
import contextlib
import dataclasses
import hashlib
import itertools
import json
import os
import pathlib
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from typing import Any, overload

import numpy as np
from array_record.python import (
    array_record_data_source,
    array_record_module,  # pyright: ignore[reportAttributeAccessIssue]
)

from ha2g_jax.data import clip_checks, records, schema
from ha2g_jax.data.records import Clip
from ha2g_jax.data.statistics import MotionStatistics
from ha2g_jax.errors import UserError
from ha2g_jax.skeleton import SKELETONS, Skeleton, load_skeleton
from ha2g_jax.text import Vocabulary

TRAIN = "train"

_FILE = "dataset.json"
_MAX_FILE = 1 << 26  # bytes of dataset.json; a thousand hours need less than a hundredth
_CLIPS_PER_SHARD = 1000
# Records one by one, so that any clip is read alone; the rest are the library's defaults.
_WRITER_OPTIONS = "group_size:1"


class CorpusWriter:
    """Writes a corpus into a temporary folder beside `path`, which takes its place only when all is written.

    Use as a context manager; an exception inside it leaves nothing behind.

    Args:
        path: folder to make; must not exist.
        splits: names of the splits; statistics and vocabulary are those of "train". Some may stay empty, not all.
        skeleton: name of the skeleton of the clips.
        fps: frames per second of the positions.
        metadata: name, source, licence and whatever else describes the corpus; stored as given.

    Attributes:
        metadata: as given; may be added to until the end.

    Raises:
        UserError: `path` exists or cannot be written, a split has no plain name, or at the end there is no clip.
    """

    def __init__(
        self, path: str | os.PathLike, *, splits: Sequence[str], skeleton: str, fps: float, metadata: dict[str, Any]
    ):
        self._path = pathlib.Path(path)
        if os.path.lexists(self._path):
            raise _exists(self._path)
        for split in splits:
            if not split.replace("-", "_").isidentifier():
                raise UserError(f"{split!r} cannot name a split; use letters, digits and _")
        self._skeleton, self._fps, self.metadata = load_skeleton(skeleton), fps, dict(metadata)
        self._counts = dict.fromkeys(splits, 0)
        self._windows, self._seconds = dict.fromkeys(splits, 0), dict.fromkeys(splits, 0.0)
        self._speakers: dict[str, list[str]] = {split: [] for split in splits}
        self._words: collections.Counter[str] = collections.Counter()
        self._statistics = MotionStatistics(self._skeleton)
        self._shards: dict[str, list[str]] = {split: [] for split in splits}
        self._writer: array_record_module.ArrayRecordWriter | None = None
        self._open_split = ""

    def __enter__(self) -> "CorpusWriter":
        self._new_folders = [folder for folder in self._path.parents if not folder.exists()]
        with self._writing():
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._folder = pathlib.Path(tempfile.mkdtemp(prefix=f".{self._path.name}-", dir=self._path.parent))
        return self

    def __exit__(self, error_type: type | None, *_: object) -> None:
        try:
            if error_type is None:
                self._close_shard()
                self._finish()
            else:
                with contextlib.suppress(UserError):  # the error inside is the one to hear of
                    self._close_shard()
        finally:
            shutil.rmtree(self._folder, ignore_errors=True)
            with contextlib.suppress(OSError):  # a folder that is not empty stays
                for folder in self._new_folders:
                    folder.rmdir()

    def add(self, split: str, record: bytes) -> None:
        """Appends an encoded clip; the clips of a split come one after the other."""
        if self._open_split != split or self._counts[split] % _CLIPS_PER_SHARD == 0:
            self._close_shard()
            shard = f"{split}-{len(self._shards[split]):05d}.array_record"
            self._shards[split].append(shard)
            with self._writing():
                self._writer = array_record_module.ArrayRecordWriter(str(self._folder / shard), _WRITER_OPTIONS)
            self._open_split = split
        assert self._writer is not None
        with self._writing():
            self._writer.write(record)
        self._counts[split] += 1
        fields = records.unpack(record)
        self._windows[split] += len(fields["window_starts"])
        self._seconds[split] += len(fields["positions"]) / self._fps
        if fields["speaker"] not in self._speakers[split]:
            self._speakers[split].append(fields["speaker"])
        if split == TRAIN:
            self._words.update(word.text.lower() for word in fields["words"])
            self._statistics.update(fields["positions"], fields["window_starts"])

    def _close_shard(self) -> None:
        writer, self._writer = self._writer, None
        if writer is not None:
            with self._writing():
                writer.close()

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        """What goes wrong here is the place's fault: it is full, or no folder can be made there."""
        try:
            yield
        except (OSError, RuntimeError, ValueError) as error:  # the latter two: ArrayRecord's
            reason = getattr(error, "strerror", None) or str(error).split(";")[0]
            raise UserError(
                f"cannot write {self._path} ({' '.join(reason.split()).lower()}); choose another place, or make room"
            ) from error

    def _finish(self) -> None:
        if not any(self._counts.values()):
            raise UserError(f"no clip to write to {self._path}; give more data")
        speakers = [*self._speakers.get(TRAIN, []), *(name for names in self._speakers.values() for name in names)]
        dataset = {
            "schema_version": schema.VERSION,
            **self.metadata,
            "skeleton": self._skeleton.name,
            "fps": self._fps,
            "speakers": list(dict.fromkeys(speakers)),
            "splits": {
                split: {
                    "clips": self._counts[split],
                    "windows": self._windows[split],
                    "seconds": round(self._seconds[split], 3),
                    "speakers": self._speakers[split],
                    "shards": [_describe(self._folder / shard) for shard in self._shards[split]],
                }
                for split in self._counts
            },
            "statistics": self._statistics.result(),
            "words": dict(sorted(self._words.items())),
        }
        with self._writing():
            (self._folder / _FILE).write_text(json.dumps(dataset, indent=1) + "\n")
            self._folder.chmod(0o755)
            try:
                self._folder.rename(self._path)
            except OSError as error:
                if os.path.lexists(self._path):  # made by another process meanwhile
                    raise _exists(self._path) from error
                raise


def _exists(path: pathlib.Path) -> UserError:
    return UserError(f"{path} exists already; choose another folder or remove it")


def _describe(shard: pathlib.Path) -> dict[str, Any]:
    with shard.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    return {"name": shard.name, "bytes": shard.stat().st_size, "sha256": digest}


class Clips(Sequence[Clip]):
    """The clips of one split, decoded when asked for. Can be pickled.

    Raises:
        UserError: a shard cannot be read.
    """

    def __init__(self, shards: Sequence[pathlib.Path]):
        # One source a shard, so that an error can name the shard.
        self._shards = list(shards)
        self._sources = [_open_shard(shard) for shard in self._shards]
        self._ends = list(itertools.accumulate(len(source) for source in self._sources))

    def __len__(self) -> int:
        return self._ends[-1] if self._ends else 0

    @overload
    def __getitem__(self, index: int) -> Clip: ...
    @overload
    def __getitem__(self, index: slice) -> list[Clip]: ...
    def __getitem__(self, index: int | slice) -> Clip | list[Clip]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        index = range(len(self))[index]
        return records.decode_clip(self.record(index), self.place(index))

    def fields(self, index: int) -> dict[str, Any]:
        """The fields of a clip with audio and frames still compressed.

        Raises:
            UserError: the record cannot be read or is damaged.
        """
        fields = records.unpack(self.record(index), self.place(index))
        if wrong := clip_checks.wrong_types(fields):
            raise UserError(
                f"clip {fields['id']!r} ({self.place(index)}) has {', '.join(wrong)} of a wrong type; "
                "make or import the corpus again"
            )
        return fields

    def record(self, index: int) -> bytes:
        """The encoded clip."""
        shard, number = self._locate(index)
        try:
            return self._sources[shard][number]
        except (ValueError, RuntimeError) as error:
            raise _unreadable(self.place(index), error) from error

    def place(self, index: int) -> str:
        """Where the record of a clip is, to name it in a message."""
        shard, number = self._locate(index)
        return f"record {number} of {self._shards[shard]}"

    def _locate(self, index: int) -> tuple[int, int]:
        shard = bisect.bisect_right(self._ends, index)
        return shard, index - (self._ends[shard - 1] if shard else 0)


def _open_shard(shard: pathlib.Path) -> array_record_data_source.ArrayRecordDataSource:
    if not os.access(shard, os.R_OK):
        raise UserError(f"{shard} may not be read by this user; change its permissions (chmod a+r)")
    try:
        return array_record_data_source.ArrayRecordDataSource([str(shard)])
    except (ValueError, RuntimeError) as error:
        raise _unreadable(str(shard), error) from error


def _unreadable(what: str, error: Exception) -> UserError:
    reason = str(error).splitlines()[0]
    return UserError(f"{what} cannot be read ({reason}); make or import the corpus again")


@dataclasses.dataclass(frozen=True)
class Corpus:
    """A corpus that `CorpusWriter` wrote.

    Attributes:
        path: its folder.
        metadata: the contents of `dataset.json`.
    """

    path: pathlib.Path
    metadata: dict[str, Any]

    @classmethod
    def open(cls, path: str | os.PathLike) -> "Corpus":
        """Opens the corpus in a folder.

        Raises:
            UserError: there is none, or it is incomplete or of another version.
        """
        path = pathlib.Path(path)
        try:
            if not (path / _FILE).is_file():
                raise UserError(f"no corpus in {path}: {_FILE} is missing; make one with `ha2g data` (see its --help)")
            if (path / _FILE).stat().st_size > _MAX_FILE:
                raise UserError(f"{path / _FILE} has more than {_MAX_FILE} bytes; make or import the corpus again")
            metadata = json.loads((path / _FILE).read_text())
        except OSError as error:
            raise UserError(f"{path / _FILE} cannot be read ({error.strerror}); check its permissions") from error
        except (ValueError, RecursionError) as error:
            raise UserError(f"{path / _FILE} is damaged ({error}); make or import the corpus again") from error
        version = metadata.get("schema_version") if isinstance(metadata, dict) else None
        if version not in range(1, schema.VERSION + 1):
            raise UserError(
                f"{path / _FILE} has schema version {version}, this version of ha2g-jax reads 1 to {schema.VERSION}: "
                "take a newer one, or make or import the corpus again"
            )
        try:
            corpus = cls(path, schema.upgrade(metadata))
            schema.check(corpus.metadata)
            shards = [shard for split in metadata["splits"].values() for shard in split["shards"]]
            sizes = {path / shard["name"]: shard["bytes"] for shard in shards}
            _ = corpus.skeleton
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            reason = f"{error} is missing" if isinstance(error, KeyError) else error
            raise UserError(f"{path / _FILE} is damaged ({reason}); make or import the corpus again") from error
        for shard, size in sizes.items():
            found = shard.stat().st_size if shard.is_file() else 0
            if found != size:
                raise UserError(f"{shard} has {found} bytes instead of {size}; make or import the corpus again")
        return corpus

    @property
    def fps(self) -> float:
        return self.metadata["fps"]

    @property
    def splits(self) -> tuple[str, ...]:
        return tuple(self.metadata["splits"])

    @property
    def speakers(self) -> tuple[str, ...]:
        """Names of all speakers, those of the training split first; the index is the speaker's id."""
        return tuple(self.metadata["speakers"])

    @property
    def skeleton(self) -> Skeleton:
        """The skeleton with the statistics of this corpus' training split, or the published ones where it has none."""
        if self.metadata["skeleton"] not in SKELETONS:
            raise UserError(
                f"{self.path} has an unknown skeleton {self.metadata['skeleton']!r}, not one of {SKELETONS}"
            )
        statistics = {name: np.array(values, np.float32) for name, values in self.metadata["statistics"].items()}
        return dataclasses.replace(load_skeleton(self.metadata["skeleton"]), **statistics)

    def has_clips(self, split: str) -> bool:
        """Whether there is such a split with a clip in it."""
        return bool(self.metadata["splits"].get(split, {}).get("clips"))

    def speakers_of(self, split: str) -> tuple[str, ...]:
        """Names of the speakers of one split."""
        return tuple(self._split(split)["speakers"])

    def vocabulary(self) -> Vocabulary:
        """The words of the training split."""
        words = self.metadata["words"]
        # As `Vocabulary.from_words` orders them; here the words are counted already.
        return Vocabulary(tuple(sorted(words, key=lambda word: (-words[word], word))))

    def clips(self, split: str) -> Clips:
        """The clips of one split.

        Raises:
            UserError: there is no such split.
        """
        return Clips([self.path / shard["name"] for shard in self._split(split)["shards"]])

    def _split(self, split: str) -> dict[str, Any]:
        if split not in self.splits:
            raise UserError(f"{self.path} has no split {split!r}; it has {', '.join(self.splits)}")
        return self.metadata["splits"][split]
