"""Import of motion files of any format, each with its audio and words, as one corpus."""

import collections
import dataclasses
import functools
import logging
import os
import pathlib
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import tqdm

from ha2g_jax.data import recording, records
from ha2g_jax.data.corpus_writer import CorpusWriter
from ha2g_jax.data.processes import parallel_map
from ha2g_jax.data.recording import MOCAP, Recording, Report, SplitReport, cut, to_clips
from ha2g_jax.data.records import Clip
from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import shown
from ha2g_jax.motion.readers.recordings import MotionRecording, compare_lengths, read_speech
from ha2g_jax.skeleton import Skeleton, bone_lengths, directions_to_positions, load_skeleton, positions_to_directions

UNUSABLE = "unusable recording"

_DIED = "a process that read the files was killed, perhaps because memory ran out; import fewer files at once"

_logger = logging.getLogger(__name__)


@dataclasses.dataclass(frozen=True)
class ImportOptions:
    """Options of `import_bvh` and `import_smplx`.

    Attributes:
        skeleton: name of the skeleton, "ted_expressive", or "ted_gesture" for motion without fingers.
        fps: frames per second of the corpus.
        speaker: name of the speaker of all files; by default it is taken from the names of files and folders, see
            `recordings.find_recordings`.
        audio: audio file of the only motion file, in any format of `read_audio`; by default it lies beside the motion.
        words: transcript of the only motion file; by default it lies beside the motion.
        with_words: whether a recording needs a transcript; if not, windows may have no words.
        split: name of the split to write.
        licence: licence of the data, stored in the corpus.
    """

    skeleton: str = "ted_expressive"
    fps: float = 15
    speaker: str | None = None
    audio: str | os.PathLike | None = None
    words: str | os.PathLike | None = None
    with_words: bool = True
    split: str = "train"
    licence: str = ""


class FileMotion(NamedTuple):
    """The motion of one file.

    Attributes:
        positions: (T, joints, 3) metres in the axes of the skeleton, float32, at the corpus' frame rate.
        seconds: length of the motion in the file.
        description: how the file was interpreted, which is stored in the corpus.
        is_good: (T,) whether a pose can be used, None if all can. A recording is divided where poses cannot.
    """

    positions: np.ndarray
    seconds: float
    description: str
    is_good: np.ndarray | None = None


class _Result(NamedTuple):
    """The encoded clips of one file, or the reason why there are none."""

    clips: list[bytes]
    report: SplitReport
    description: str = ""
    warning: str | None = None
    error: str | None = None


def import_files(
    recordings: Sequence[MotionRecording],
    read: Callable[[pathlib.Path], FileMotion],
    dst: str | os.PathLike,
    options: ImportOptions,
    *,
    name: str,
    source: str,
) -> Report:
    """Write a corpus of motion files, which one process per core reads; their order is kept.

    Among several files, an unusable one is left out with a warning and counted as rejected. Motion and audio that
    differ in length by more than half a second are cut to the shorter one, with a warning.

    Args:
        read: picklable function that returns the motion of a file, or raises `UserError`.

    Raises:
        UserError: no file can be used, no window is left, or `dst` exists.
    """
    total, errors, descriptions = SplitReport(), list[str](), collections.Counter[str]()
    one = functools.partial(_import_file, read=read, options=options)
    metadata = {"name": name, "source": source, "licence": options.licence}
    count = len(recordings)
    with (
        CorpusWriter(
            dst, splits=(options.split,), skeleton=options.skeleton, fps=options.fps, metadata=metadata
        ) as writer,
        parallel_map(min(os.cpu_count() or 1, count), _DIED) as each,
    ):
        for result in tqdm.tqdm(each(one, recordings), "motion", count, unit="file", disable=None, leave=False):
            total += result.report
            if result.warning:
                _logger.warning("%s", result.warning)
            if result.error:
                errors.append(result.error)
                if count > 1:
                    _logger.warning("left out: %s", result.error)
                continue
            descriptions[result.description] += 1
            for clip in result.clips:
                writer.add(options.split, clip)
        if len(errors) == count:
            only = errors[0] if len(errors) == 1 else f"all {len(errors)} files failed; the first: {errors[0]}"
            raise UserError(only)
        if not total.kept:
            place = os.path.commonpath([recording.path for recording in recordings])
            reasons = ", ".join(f"{reason} {number}" for reason, number in (total.filtered + total.rejected).items())
            raise UserError(
                f"{shown(place)} has no usable window (left out: {reasons}); give longer or livelier recordings"
            )
        report = {options.split: total}
        writer.metadata |= {"motion": dict(sorted(descriptions.items())), "import": recording.report_as_json(report)}
    return report


def _import_file(
    recording: MotionRecording, read: Callable[[pathlib.Path], FileMotion], options: ImportOptions
) -> _Result:
    """Return the clips of one file, or its error."""
    try:
        motion = read(recording.path)
        audio, words = read_speech(recording, with_words=options.with_words)
        warning = compare_lengths(recording, motion.seconds, audio)
    except UserError as error:
        return _failed(str(error))
    skeleton = load_skeleton(options.skeleton)
    positions = with_constant_lengths(motion.positions, skeleton)
    filters = MOCAP if words is not None else MOCAP._replace(min_words=None)
    content = Recording(recording.name, recording.speaker, audio, words or (), positions)
    clips, report = list[Clip](), SplitReport()
    stretches = _good_stretches(motion.is_good, len(positions))
    if not stretches:
        return _failed(f"{shown(recording.path)} has no frame in which the person was tracked")
    for start, end in stretches:
        part = cut(content, start, end, options.fps)
        new, counts = to_clips(part, skeleton, fps=options.fps, filters=filters, first=report.clips)
        clips, report = clips + new, report + counts
    report.videos = 1
    return _Result([records.encode_clip(clip) for clip in clips], report, motion.description, warning)


def _failed(error: str) -> _Result:
    return _Result([], SplitReport(rejected=collections.Counter({UNUSABLE: 1})), error=error)


def _good_stretches(is_good: np.ndarray | None, count: int) -> list[tuple[int, int]]:
    """Return first and last + 1 of the frames of each stretch that can be used."""
    good = np.ones(count, bool) if is_good is None else is_good
    borders = np.flatnonzero(np.diff(np.concatenate([[False], good, [False]]).astype(np.int8)))
    return [(int(start), int(end)) for start, end in borders.reshape(-1, 2)]


def with_constant_lengths(positions: np.ndarray, skeleton: Skeleton) -> np.ndarray:
    """Set each bone of positions (T, joints, 3) to its mean length; the root and all direction vectors stay.

    The skeleton has bones from the neck to a shoulder and to the nose, where a body has joints in between (collarbone,
    head), so that these distances vary in motion capture. In the corpus, each bone has a constant length.
    """
    precise = positions.astype(np.float64)
    measured = dataclasses.replace(skeleton, lengths=bone_lengths(skeleton, precise).mean(axis=0))
    joints = directions_to_positions(measured, positions_to_directions(measured, precise))
    return (precise[:, :1] + joints).astype(positions.dtype)
