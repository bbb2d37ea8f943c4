"""A corpus on disk: ArrayRecord shards of clips and one `dataset.json` with the statistics of the training split."""

import bisect
import dataclasses
import itertools
import os
import pathlib
import reprlib
from collections.abc import Sequence
from typing import Any, overload

from array_record.python import array_record_data_source

from ha2g_jax.data import clip_checks, records, schema
from ha2g_jax.data.records import Clip
from ha2g_jax.errors import UserError
from ha2g_jax.features.text import Vocabulary
from ha2g_jax.files.cache import cache_folder
from ha2g_jax.files.reading import check_utf8, parse_json, reading, reason, shown
from ha2g_jax.limits import MAX_NAME_LENGTH
from ha2g_jax.skeleton import Skeleton, load_skeleton

TRAIN = schema.TRAIN
FILE = "dataset.json"

TALK = "talk"  # name of the Talk corpus in configs and commands
_TALK_FOLDER = "talk-v3"


def corpus_folder(name: str) -> pathlib.Path:
    """Return the folder of a corpus: of the Talk corpus, in the user's cache, for "talk", else the name as a path."""
    return cache_folder() / _TALK_FOLDER if name == TALK else pathlib.Path(name)


class Clips(Sequence[Clip]):
    """The clips of one split, each decoded on access. Can be pickled.

    Args:
        shards: files of the split, in order.

    Raises:
        UserError: a shard cannot be read.
    """

    def __init__(self, shards: Sequence[pathlib.Path], skeleton: Skeleton, fps: float):
        # One data source per shard, so that an error can name the shard.
        self._shards, self._skeleton, self.fps = list(shards), skeleton, fps
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
        return records.decode_fields(self.fields(index), self.place(index), self.fps)

    def fields(self, index: int) -> dict[str, Any]:
        """Return the fields of a clip, see `records.unpack`, with audio and images still compressed.

        Raises:
            UserError: the record cannot be read or is damaged, or its motion is not finite, or not of the skeleton
                of the corpus.
        """
        fields = records.unpack(self.record(index), self.place(index))
        if found := clip_checks.problem(fields, self._skeleton):
            raise UserError(
                f"{self.title(fields, index)} has {found}; "
                "correct or remove this clip in the original data and make or import the corpus again "
                "(ha2g data inspect --check finds all errors)"
            )
        return fields

    def title(self, fields: dict[str, Any], index: int) -> str:
        """Return the id of a clip and the location of its record, for error messages."""
        return f"clip {repr(fields['id'])[:MAX_NAME_LENGTH]} ({self.place(index)})"

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
    if not os.access(shard, os.R_OK):
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

    @classmethod
    def open(cls, path: str | os.PathLike) -> "Corpus":
        """Open the corpus in a folder.

        Raises:
            UserError: there is no corpus, or it is incomplete or of an unknown version.
        """
        path = pathlib.Path(path)
        check_utf8(path)
        file = path / FILE
        with reading(file, "the description of a corpus"):
            content = file.read_bytes() if file.is_file() else None
        if content is None:
            raise UserError(
                f"no corpus in {shown(path)}: {FILE} is missing; make one with `ha2g data` (see its --help)"
            )
        try:
            corpus = cls(path, _checked(content, shown(file)))
        except (KeyError, TypeError, ValueError, AttributeError, RecursionError, OverflowError) as error:
            why = f"{error} is missing" if isinstance(error, KeyError) else reason(error)
            raise UserError(f"{shown(file)} is damaged ({why}); make or import the corpus again") from error
        for entry in corpus.metadata["splits"].values():
            for shard in entry["shards"]:
                _check_size(path / shard["name"], shard["bytes"])
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
        return dataclasses.replace(load_skeleton(self.metadata["skeleton"]), **schema.statistics(self.metadata))

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
            UserError: there is no such split, or its shards have another number of clips than `dataset.json` says.
        """
        entry = self._split(split)
        clips = Clips([self.path / shard["name"] for shard in entry["shards"]], self.skeleton, self.fps)
        if len(clips) != entry["clips"]:
            raise UserError(
                f"{shown(self.path / FILE)} counts {entry['clips']} clips in {split!r}, but its shards have "
                f"{len(clips)}; make or import the corpus again"
            )
        return clips

    def _split(self, split: str) -> dict[str, Any]:
        if split not in self.splits:
            raise UserError(f"{shown(self.path)} has no split {split[:60]!r}; it has {', '.join(self.splits)}")
        return self.metadata["splits"][split]


def _checked(content: bytes, name: str) -> dict[str, Any]:
    metadata = parse_json(content)
    version = metadata.get("schema_version") if isinstance(metadata, dict) else None
    if version != schema.VERSION or type(version) is not int:
        raise UserError(
            f"{name} has schema version {reprlib.repr(version)}, this version of ha2g-jax reads {schema.VERSION}; "
            "upgrade ha2g-jax, or make or import the corpus again"
        )
    schema.check(metadata)
    return metadata


def _check_size(shard: pathlib.Path, size: int) -> None:
    try:
        found = shard.stat().st_size if shard.is_file() else 0
    except OSError as error:
        raise UserError(f"{shown(shard)} cannot be read ({reason(error)})") from error
    if found != size:
        raise UserError(f"{shown(shard)} has {found} bytes instead of {size}; make or import the corpus again")
