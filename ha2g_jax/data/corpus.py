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

from ha2g_jax.data import clip_checks, records, schema
from ha2g_jax.data.records import Clip
from ha2g_jax.errors import UserError
from ha2g_jax.features.text import Vocabulary
from ha2g_jax.files.reading import check_utf8
from ha2g_jax.skeleton import SKELETONS, Skeleton, load_skeleton

TRAIN = "train"
FILE = "dataset.json"
_MAX_FILE = 1 << 26  # bytes of dataset.json; a thousand hours need less than a hundredth


class Clips(Sequence[Clip]):
    """The clips of one split, each decoded on access. Can be pickled.

    Args:
        shards: files of the split, in order.

    Raises:
        UserError: a shard cannot be read.
    """

    def __init__(self, shards: Sequence[pathlib.Path]):
        # One data source per shard, so that an error can name the shard.
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
        """Return the fields of a clip with audio and images still compressed.

        Args:
            index: number of the clip in the split.

        Returns:
            The fields that `records.unpack` returns.

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
        return f"record {number} of {self._shards[shard]}"

    def _locate(self, index: int) -> tuple[int, int]:
        shard = bisect.bisect_right(self._ends, index)
        return shard, index - (self._ends[shard - 1] if shard else 0)


def _open_shard(shard: pathlib.Path) -> array_record_data_source.ArrayRecordDataSource:
    if not os.access(shard, os.R_OK):
        raise UserError(f"{shard} cannot be read by this user; change its permissions (chmod a+r)")
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
        path: folder of the corpus.
        metadata: contents of `dataset.json`.
    """

    path: pathlib.Path
    metadata: dict[str, Any]

    @classmethod
    def open(cls, path: str | os.PathLike) -> "Corpus":
        """Open the corpus in a folder.

        Args:
            path: folder of the corpus.

        Raises:
            UserError: there is no corpus, or it is incomplete or of an unknown version.
        """
        path = pathlib.Path(path)
        check_utf8(path)
        try:
            if not (path / FILE).is_file():
                raise UserError(f"no corpus in {path}: {FILE} is missing; make one with `ha2g data` (see its --help)")
            if (path / FILE).stat().st_size > _MAX_FILE:
                raise UserError(f"{path / FILE} has more than {_MAX_FILE} bytes; make or import the corpus again")
            metadata = json.loads((path / FILE).read_text())
        except OSError as error:
            raise UserError(f"{path / FILE} cannot be read ({error.strerror}); check its permissions") from error
        except (ValueError, RecursionError) as error:
            raise UserError(f"{path / FILE} is damaged ({error}); make or import the corpus again") from error
        version = metadata.get("schema_version") if isinstance(metadata, dict) else None
        if version not in range(1, schema.VERSION + 1):
            raise UserError(
                f"{path / FILE} has schema version {version}, this version of ha2g-jax reads 1 to {schema.VERSION}; "
                "upgrade ha2g-jax, or make or import the corpus again"
            )
        try:
            corpus = cls(path, schema.upgrade(metadata))
            schema.check(corpus.metadata)
            shards = [shard for split in metadata["splits"].values() for shard in split["shards"]]
            sizes = {path / shard["name"]: shard["bytes"] for shard in shards}
            _ = corpus.skeleton
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            reason = f"{error} is missing" if isinstance(error, KeyError) else error
            raise UserError(f"{path / FILE} is damaged ({reason}); make or import the corpus again") from error
        for shard, size in sizes.items():
            found = shard.stat().st_size if shard.is_file() else 0
            if found != size:
                raise UserError(f"{shard} has {found} bytes instead of {size}; make or import the corpus again")
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
        """Skeleton with the statistics of the training split, or the published ones if there is no training split."""
        if self.metadata["skeleton"] not in SKELETONS:
            raise UserError(
                f"{self.path} has an unknown skeleton {self.metadata['skeleton']!r}, not one of {SKELETONS}"
            )
        statistics = {name: np.array(values, np.float32) for name, values in self.metadata["statistics"].items()}
        return dataclasses.replace(load_skeleton(self.metadata["skeleton"]), **statistics)

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
            UserError: there is no such split.
        """
        return Clips([self.path / shard["name"] for shard in self._split(split)["shards"]])

    def _split(self, split: str) -> dict[str, Any]:
        if split not in self.splits:
            raise UserError(f"{self.path} has no split {split!r}; it has {', '.join(self.splits)}")
        return self.metadata["splits"][split]
