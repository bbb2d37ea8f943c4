"""Many files of motion, each with its sound and words, as one corpus: what the importers of all formats share."""

import collections
import dataclasses
import functools
import logging
import os
import pathlib
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import tqdm

from ha2g_jax.data import import_report, records
from ha2g_jax.data.corpus_writer import CorpusWriter
from ha2g_jax.data.import_report import Report, SplitReport
from ha2g_jax.data.mocap.sources import Source, compare_lengths, read_speech
from ha2g_jax.data.processes import parallel_map
from ha2g_jax.data.recording import Recording, to_clips
from ha2g_jax.data.window_filters import MOCAP
from ha2g_jax.errors import UserError
from ha2g_jax.skeleton import Skeleton, directions_to_positions, load_skeleton, positions_to_directions

UNUSABLE = "unusable recording"

_DIED = "a process that read the files was killed, perhaps for want of memory; import fewer files at once"

_logger = logging.getLogger(__name__)


class FileMotion(NamedTuple):
    """The motion of one file.

    Attributes:
        positions: (T, joints, 3) metres in the axes of the skeleton, float32, at the corpus' frame rate.
        seconds: length of the motion in the file.
        understood: how the file was read, for the corpus' notes.
    """

    positions: np.ndarray
    seconds: float
    understood: str


class _Result(NamedTuple):
    """The encoded clips of one file, or the reason why there are none."""

    clips: list[bytes]
    report: SplitReport
    understood: str = ""
    warning: str | None = None
    error: str | None = None


def import_files(
    sources: Sequence[Source],
    read: Callable[[pathlib.Path], FileMotion],
    dst: str | os.PathLike,
    *,
    skeleton: str,
    fps: float,
    split: str,
    with_words: bool,
    metadata: dict[str, Any],
) -> Report:
    """Writes a corpus of files of motion; one process a core reads them, their order stays.

    Of several files, one that cannot be used is left out with a warning and counted under `rejected`. Motion and sound
    that differ in length by more than half a second are cut to the shorter, with a warning.

    Args:
        sources: the files with what belongs to them.
        read: gives the motion of a file, or raises UserError; must be picklable.
        dst: folder to make.
        skeleton: name of the skeleton.
        fps: frames per second of the corpus.
        split: name of the split to write.
        with_words: whether a recording needs a transcript; without one, its windows need no words.
        metadata: of the corpus; how files were understood and the report are added.

    Returns:
        What was kept and left out.

    Raises:
        UserError: no file can be used, no window is left, or `dst` exists.
    """
    total, errors, understood = SplitReport(), list[str](), collections.Counter[str]()
    one = functools.partial(_import_file, read=read, skeleton=skeleton, fps=fps, with_words=with_words)
    with (
        CorpusWriter(dst, splits=(split,), skeleton=skeleton, fps=fps, metadata=metadata) as writer,
        parallel_map(min(os.cpu_count() or 1, len(sources)), _DIED) as each,
    ):
        for result in tqdm.tqdm(each(one, sources), "motion", len(sources), unit="file", disable=None, leave=False):
            total += result.report
            if result.warning:
                _logger.warning("%s", result.warning)
            if result.error:
                errors.append(result.error)
                if len(sources) > 1:
                    _logger.warning("left out: %s", result.error)
                continue
            understood[result.understood] += 1
            for clip in result.clips:
                writer.add(split, clip)
        if len(errors) == len(sources):
            only = errors[0] if len(errors) == 1 else f"all {len(errors)} files failed; the first: {errors[0]}"
            raise UserError(only)
        if not total.kept:
            place = os.path.commonpath([source.path for source in sources])
            reasons = ", ".join(f"{reason} {count}" for reason, count in (total.filtered + total.rejected).items())
            raise UserError(f"{place} has no window that can be used: left out {reasons}")
        report = {split: total}
        writer.metadata |= {"motion": dict(sorted(understood.items())), "import": import_report.as_json(report)}
    return report


def _import_file(
    source: Source, read: Callable[[pathlib.Path], FileMotion], skeleton: str, fps: float, with_words: bool
) -> _Result:
    """The clips of one file; a fault of the file is part of the result."""
    try:
        motion = read(source.path)
        audio, words = read_speech(source, with_words=with_words)
        warning = compare_lengths(source, motion.seconds, audio)
    except UserError as error:
        return _Result([], SplitReport(rejected=collections.Counter({UNUSABLE: 1})), error=str(error))
    definition = load_skeleton(skeleton)
    positions = with_constant_lengths(motion.positions, definition)
    filters = MOCAP if words is not None else MOCAP._replace(min_words=None)
    recording = Recording(source.talk, source.speaker, audio, words or (), positions)
    clips, report = to_clips(recording, definition, fps=fps, filters=filters)
    return _Result([records.encode_clip(clip) for clip in clips], report, motion.understood, warning)


def with_constant_lengths(positions: np.ndarray, skeleton: Skeleton) -> np.ndarray:
    """The motion with each bone at its mean length; the root and all direction vectors stay.

    From the neck to a shoulder, or to the nose, there is no bone in a body: the collarbone and the head turn between
    them. Those of the skeleton have one length each.

    Args:
        positions: (T, joints, 3) in metres.
        skeleton: of the joints.

    Returns:
        (T, joints, 3) in the type of `positions`.
    """
    precise = positions.astype(np.float64)
    parents, children = (list(ends) for ends in zip(*skeleton.bones, strict=True))
    lengths = np.linalg.norm(precise[:, children] - precise[:, parents], axis=-1).mean(axis=0)
    measured = dataclasses.replace(skeleton, lengths=lengths)
    joints = directions_to_positions(measured, positions_to_directions(measured, precise))
    return (precise[:, :1] + joints).astype(positions.dtype)
