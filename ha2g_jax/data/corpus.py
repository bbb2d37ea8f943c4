"""A corpus on disk: ArrayRecord shards of clips and one `dataset.json` with the statistics of the training split."""

import bisect
import dataclasses
import itertools
import json
import os
import pathlib
from collections.abc import Sequence
from typing import Any, overload

import numpy as np
from array_record.python import array_record_data_source

from ha2g_jax.data import records
from ha2g_jax.data.records import Clip
from ha2g_jax.errors import UserError
from ha2g_jax.features.text import Vocabulary
from ha2g_jax.files.cache import cache_folder
from ha2g_jax.files.reading import check_utf8, reading, reason, shown
from ha2g_jax.skeleton import Skeleton, load_skeleton

TRAIN = "train"
FILE = "dataset.json"
VERSION = 2  # of the format of `FILE`

TALK = "talk"  # name of the Talk corpus in configs and commands
TALK_VERSION = "talk-v4"


def corpus_folder(name: str) -> pathlib.Path:
    """Return the folder of a corpus: for "talk" that of the Talk corpus in the user's cache, else `name` as a path."""
    return cache_folder() / TALK_VERSION if name == TALK else pathlib.Path(name)


class Clips(Sequence[Clip]):
    """The clips of one split, in the order of its shards, each decoded on access. Can be pickled.

    Raises:
        UserError: a shard cannot be read.
    """

    def __init__(self, shards: Sequence[pathlib.Path], fps: float):
        # One data source per shard, so that an error can name the shard.
        self._shards, self.fps = list(shards), fps
        self._sources = [_open_shard(shard) for shard in self._shards]
        self._ends = list(itertools.accumulate(len(source) for source in self._sources))

    def __repr__(self) -> str:
        return f"Clips({len(self)} clips, {self.fps:g} fps)"

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
        """Return the fields of a clip, see `records.unpack`, with audio and images still compressed.

        Raises:
            UserError: the record cannot be read or is damaged.
        """
        return records.unpack(self.record(index), self.place(index))

    def title(self, fields: dict[str, Any], index: int) -> str:
        """Return the id of a clip and the location of its record, for error messages."""
        return f"clip {fields['id']!r} ({self.place(index)})"

    def record(self, index: int) -> bytes:
        """Return the encoded clip with number `index`.

        Raises:
            UserError: the record cannot be read.
        """
        shard, number = self._locate(index)
        try:
            return self._sources[shard][number]
        except (ValueError, RuntimeError) as error:
            raise _unreadable(self.place(index), error) from error

    def place(self, index: int) -> str:
        """Return the location of the record of a clip, for error messages: "record NUMBER of SHARD"."""
        shard, number = self._locate(index)
        return f"record {number} of {shown(self._shards[shard])}"

    def _locate(self, index: int) -> tuple[int, int]:
        shard = bisect.bisect_right(self._ends, index)
        return shard, index - (self._ends[shard - 1] if shard else 0)


def _open_shard(shard: pathlib.Path) -> array_record_data_source.ArrayRecordDataSource:
    if shard.exists() and not os.access(shard, os.R_OK):
        raise UserError(f"{shown(shard)} cannot be read by this user; change its permissions (chmod a+r)")
    try:
        return array_record_data_source.ArrayRecordDataSource([str(shard)])
    except (ValueError, RuntimeError) as error:
        raise _unreadable(shown(shard), error) from error


def _unreadable(what: str, error: Exception) -> UserError:
    return UserError(f"{what} cannot be read ({reason(error)}); make or import the corpus again")


@dataclasses.dataclass(frozen=True)
class Corpus:
    """A corpus that `CorpusWriter` wrote."""

    path: pathlib.Path
    metadata: dict[str, Any]

    def __repr__(self) -> str:
        splits = ", ".join(f"{split} {values['clips']}" for split, values in self.metadata["splits"].items())
        return f"Corpus({str(self.path)!r}, {self.metadata['skeleton']}, {self.fps:g} fps, clips: {splits})"

    @classmethod
    def open(cls, path: str | os.PathLike) -> "Corpus":
        """Open the corpus in a folder.

        Raises:
            UserError: there is no corpus, or it is incomplete or of an unknown version.
        """
        path = pathlib.Path(path)
        check_utf8(path)
        file = path / FILE
        with reading(file, "the description of a corpus", LookupError, TypeError, AttributeError):
            if not file.is_file():
                raise UserError(
                    f"no corpus in {shown(path)}: {FILE} is missing; make one with `ha2g data` (see its --help)"
                )
            metadata = json.loads(file.read_bytes())
            if (version := metadata["schema_version"]) != VERSION:
                raise UserError(
                    f"{shown(file)} has schema version {version}, this version of ha2g-jax reads {VERSION}; "
                    "upgrade ha2g-jax, or make or import the corpus again"
                )
            for shard in (shard for entry in metadata["splits"].values() for shard in entry["shards"]):
                _check_size(path / shard["name"], shard["bytes"])
            corpus = cls(path, metadata)
            # Each raises if it is missing.
            _ = corpus.skeleton, float(corpus.fps), corpus.speakers, dict(metadata["words"])
            _ = [(entry["clips"], entry["windows"], entry["speakers"]) for entry in metadata["splits"].values()]
        return corpus

    @property
    def fps(self) -> float:
        """Frames per second of the positions."""
        return self.metadata["fps"]

    @property
    def splits(self) -> tuple[str, ...]:
        """Names of the splits."""
        return tuple(self.metadata["splits"])

    @property
    def speakers(self) -> tuple[str, ...]:
        """Names of all speakers, those of the training split first; the index is the speaker's id."""
        return tuple(self.metadata["speakers"])

    @property
    def skeleton(self) -> Skeleton:
        """Skeleton with the statistics of the training split, or the published ones without a training split."""
        statistics = self.metadata["statistics"]
        arrays: dict[str, Any] = {name: np.array(values, np.float32) for name, values in statistics.items()}
        return dataclasses.replace(load_skeleton(self.metadata["skeleton"]), **arrays)

    @property
    def num_clips(self) -> int:
        """Number of clips of all splits."""
        return sum(entry["clips"] for entry in self.metadata["splits"].values())

    def has_clips(self, split: str) -> bool:
        """Return whether the corpus has this split and the split has a clip."""
        return bool(self.metadata["splits"].get(split, {}).get("clips"))

    def speakers_of(self, split: str) -> tuple[str, ...]:
        """Return the names of the speakers of one split.

        Raises:
            UserError: there is no such split.
        """
        return tuple(self._split(split)["speakers"])

    def vocabulary(self) -> Vocabulary:
        """Return the vocabulary of the training split."""
        return Vocabulary.from_counts(self.metadata["words"])

    def clips(self, split: str) -> Clips:
        """Return the clips of one split.

        Raises:
            UserError: there is no such split, or a shard cannot be read.
        """
        shards = [self.path / shard["name"] for shard in self._split(split)["shards"]]
        return Clips(shards, self.fps)

    def _split(self, split: str) -> dict[str, Any]:
        if split not in self.splits:
            raise UserError(f"{shown(self.path)} has no split {split[:60]!r}; it has {', '.join(self.splits)}")
        return self.metadata["splits"][split]


def _check_size(shard: pathlib.Path, size: int) -> None:
    found = shard.stat().st_size if shard.is_file() else 0
    if found != size:
        raise UserError(f"{shown(shard)} has {found} bytes instead of {size}; make or import the corpus again")
