"""Writer of a corpus: shards of clips, and `dataset.json` with their metadata and statistics of the training split."""

import collections
import contextlib
import json
import os
import pathlib
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from array_record.python import array_record_module

from ha2g_jax.data import records
from ha2g_jax.data.corpus import FILE, TRAIN, VERSION
from ha2g_jax.data.records import PAPER_FPS, WINDOW_FRAMES, frames_at
from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import check_utf8, file_sha256, shown
from ha2g_jax.files.writing import check_new, whole_folder
from ha2g_jax.limits import MAX_FPS, MIN_FPS
from ha2g_jax.skeleton import Skeleton, bone_lengths, joint_angles, load_skeleton, positions_to_directions

_CLIPS_PER_SHARD = 1000
# One record per group, so that each clip can be read alone; the other options are the library's defaults.
_WRITER_OPTIONS = "group_size:1"
_MAX_SPLIT_NAME = 60  # letters


def unusable_positions(positions: np.ndarray, skeleton: Skeleton) -> str | None:
    """Return what makes the positions of a clip useless, such as "positions that are NaN", or None."""
    if positions.ndim != 3 or positions.shape[1:] != (skeleton.num_joints, 3) or not len(positions):
        return f"positions of shape {positions.shape}, expected (T, {skeleton.num_joints}, 3) of {skeleton.name}"
    is_finite = np.isfinite(positions).all(axis=(1, 2))
    if not is_finite.all():
        return f"positions that are NaN or infinite, first in frame {is_finite.argmin()}"
    return None


class MotionStatistics:
    """Running means over the frames of all training windows: bone lengths, poses, direction vectors, angles in units of
    pi (HA2G, Eq. 8), and changes of the angles, scaled to those between frames at 15 fps.
    """

    def __init__(self, skeleton: Skeleton, fps: float):
        self._skeleton, self._fps = skeleton, fps
        self._sums: dict[str, np.ndarray] = {}
        self._frames = 0
        self._steps = 0

    def update(self, positions: np.ndarray, window_starts: Sequence[int]) -> None:
        """Add those frames of one clip, positions (T, joints, 3) in metres, that lie in a training window."""
        is_seen = np.zeros(len(positions), bool)
        for start in window_starts:
            is_seen[start : start + frames_at(WINDOW_FRAMES, self._fps)] = True
        positions = positions.astype(np.float64)
        directions = positions_to_directions(self._skeleton, positions)
        angles = joint_angles(self._skeleton, directions) / np.pi
        terms = {
            "lengths": bone_lengths(self._skeleton, positions),
            "mean_pose": positions - positions[:, :1],
            "mean_directions": directions,
            "angle_mean": angles,
            "angle_square": angles**2,
        }
        is_step = is_seen[1:] & is_seen[:-1]
        changes = {"angle_change": np.abs(np.diff(angles, axis=0))[is_step] * (self._fps / PAPER_FPS)}
        for name, term in ({name: term[is_seen] for name, term in terms.items()} | changes).items():
            self._sums[name] = self._sums.get(name, 0) + term.sum(axis=0)
        self._frames += int(is_seen.sum())
        self._steps += int(is_step.sum())

    def result(self) -> dict[str, Any]:
        """Return the means as nested lists by field name of `Skeleton`, for JSON; empty if there was no window.

        They are rounded to nine decimals, because the last bits differ between processors.
        """
        if not self._frames:
            return {}
        means = {
            name: total / (max(self._steps, 1) if name == "angle_change" else self._frames)
            for name, total in self._sums.items()
        }
        means["angle_variance"] = np.maximum(means.pop("angle_square") - means["angle_mean"] ** 2, 0)
        return {name: mean.round(9).astype(np.float32).tolist() for name, mean in means.items()}


class CorpusWriter:
    """Writer of a corpus, which writes into a temporary folder and renames it to `path` at the end.

    Use it as a context manager; an exception inside the context leaves nothing behind.

    Args:
        splits: names of the splits; statistics and vocabulary are those of "train". Some may stay empty, not all.
        metadata: description of the corpus, such as its source and licence; entries may be added until the end.

    Raises:
        UserError: `path` exists or cannot be written, the name of a split is invalid, or there is no clip at the end.
    """

    def __init__(
        self, path: str | os.PathLike, *, splits: Sequence[str], skeleton: str, fps: float, metadata: dict[str, Any]
    ):
        self._path = pathlib.Path(path)
        check_utf8(self._path)
        check_new(self._path)
        for split in splits:
            if not split.replace("-", "_").isidentifier() or len(split) > _MAX_SPLIT_NAME:
                raise UserError(f"{split[:60]!r} cannot be the name of a split; use up to 60 letters, digits, - and _")
        if not MIN_FPS <= fps <= MAX_FPS:
            raise UserError(f"a corpus of {fps:g} frames per second; give {MIN_FPS} to {MAX_FPS}")
        self._skeleton, self._fps, self.metadata = load_skeleton(skeleton), fps, dict(metadata)
        self._counts = dict.fromkeys(splits, 0)
        self._windows, self._seconds = dict.fromkeys(splits, 0), dict.fromkeys(splits, 0.0)
        self._speakers: dict[str, list[str]] = {split: [] for split in splits}
        self._words: collections.Counter[str] = collections.Counter()
        self._statistics = MotionStatistics(self._skeleton, fps)
        self._shards: dict[str, list[str]] = {split: [] for split in splits}
        self._writer: array_record_module.ArrayRecordWriter | None = None
        self._open_split = ""

    def __enter__(self) -> "CorpusWriter":
        self._end = contextlib.ExitStack()
        self._folder = self._end.enter_context(whole_folder(self._path))
        return self

    def __exit__(self, _: type | None, error: BaseException | None, __: object) -> None:
        with self._end:  # an exception in it removes the folder
            if error is None:
                self._close_shard()
                self._finish()
            else:
                with contextlib.suppress(UserError):  # the exception inside the context is the one to report
                    self._close_shard()
                raise error

    def add(self, split: str, record: bytes) -> None:
        """Append a record of `records.encode_clip` to a split; all of one split come before those of the next.

        Raises:
            UserError: the clip cannot be used or cannot be written.
        """
        fields = records.unpack(record, "a clip to write")
        if found := unusable_positions(fields["positions"], self._skeleton):
            raise UserError(f"a clip to write to {shown(self._path)}, {fields['id']!r}, has {found}")
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
        """Turn disk errors (the disk is full or not writable) into a `UserError`."""
        try:
            yield
        except (OSError, RuntimeError, ValueError) as error:  # ArrayRecord raises the last two
            why = (error.strerror if isinstance(error, OSError) else None) or str(error).split(";")[0]
            raise UserError(
                f"cannot write {shown(self._path)} ({' '.join(why.split()).lower()}); "
                "use another folder or free disk space"
            ) from error

    def _finish(self) -> None:
        if not any(self._counts.values()):
            raise UserError(f"no clip to write to {shown(self._path)}; give more data")
        speakers = [*self._speakers.get(TRAIN, []), *(name for names in self._speakers.values() for name in names)]
        dataset = {
            "schema_version": VERSION,
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
                    "shards": [self._describe(shard) for shard in self._shards[split]],
                }
                for split in self._counts
            },
            "statistics": self._statistics.result(),
            "words": dict(sorted(self._words.items())),
        }
        text = json.dumps(dataset, indent=1) + "\n"
        with self._writing():
            (self._folder / FILE).write_text(text, newline="\n")

    def _describe(self, name: str) -> dict[str, Any]:
        path = self._folder / name
        with self._writing():
            return {"name": name, "bytes": path.stat().st_size, "sha256": file_sha256(path)}
