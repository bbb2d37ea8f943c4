"""Import of motion capture, BVH and SMPL-X, with its audio and words, into a corpus."""

import collections
import dataclasses
import functools
import logging
import os
import pathlib
import re
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Unpack

import numpy as np

from ha2g_jax.data.corpus_writer import CorpusWriter
from ha2g_jax.data.processes import parallel_map
from ha2g_jax.data.recording import MOCAP, UNUSABLE, Recording, Report, SplitReport, cut, report_as_json, to_clips
from ha2g_jax.data.records import Clip, encode_clip
from ha2g_jax.errors import UserError
from ha2g_jax.features import words as transcripts
from ha2g_jax.files.reading import files_below, resolved, shown
from ha2g_jax.motion.readers import Reading, joint_maps
from ha2g_jax.motion.readers.body import UPS, check_stated
from ha2g_jax.motion.readers.bvh_motion import TREES, read_motion
from ha2g_jax.motion.readers.recordings import (
    AUDIO_SUFFIXES,
    MotionRecording,
    compare_lengths,
    find_audio,
    find_embody,
    find_recordings,
    read_speech,
)
from ha2g_jax.motion.readers.smplx import read_smplx
from ha2g_jax.motion.readers.smplx_arrays import SEAMLESS_NAME
from ha2g_jax.motion.readers.smplx_body import Body, read_body_model, template
from ha2g_jax.progress import track
from ha2g_jax.skeleton import (
    Skeleton,
    bone_lengths,
    directions_to_positions,
    load_skeleton,
    positions_to_directions,
)

_TIMED_WORDS = ".textgrid"
# BEAT2 names a recording NUMBER_SPEAKER_..., and has separate folders for motion, audio and words.
_BEAT_NAME = re.compile(r"\d+_([A-Za-z]+)(_\d+){3}")
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
        split: split that all clips go to.
        licence: licence of the recordings, which is stored in the corpus.
    """

    skeleton: str = "ted_expressive"
    fps: float = 15
    speaker: str | None = None
    audio: str | os.PathLike | None = None
    words: str | os.PathLike | None = None
    with_words: bool = True
    split: str = "train"
    licence: str = ""


_DEFAULTS = ImportOptions()


class _FileMotion(NamedTuple):
    positions: np.ndarray  # (T, joints, 3) float32 metres in the axes of the skeleton, at the corpus' frame rate
    seconds: float  # length of the motion in the file
    fps: float  # frames per second of the file
    description: str  # how the file was interpreted, which is stored in the corpus
    is_good: np.ndarray | None = None  # (T,) whether a pose can be used, None if all can


def import_bvh(
    src: str | os.PathLike,
    dst: str | os.PathLike,
    options: ImportOptions = _DEFAULTS,
    **reading: Unpack[Reading],
) -> Report:
    """Write a corpus from one file of `bvh_motion.TREES`, or from all in a folder and below it, and return its counts.

    See `recordings.find_recordings` for the audio and the transcript of each file. Among several files, an unusable one
    is left out with a warning and counted as rejected. Motion and audio that differ in length by more than half a
    second are cut to the shorter one, with a warning. The counts of kept and omitted parts are also stored in the
    corpus under "import".

    Raises:
        UserError: there is no usable file, `dst` exists, or an option has an invalid value.
    """
    src = pathlib.Path(src)
    recordings = find_recordings(src, TREES, speaker=options.speaker, audio=options.audio, words=options.words)
    check_stated(reading.get("source_fps"), reading.get("unit"))
    if (joint_map := reading.get("joint_map", joint_maps.AUTO)) != joint_maps.AUTO:
        joint_maps.load_map(joint_map)  # report an error of the map once, not for each file
    read = functools.partial(_read_bvh, options=options, reading=reading)
    name = shown(resolved(src).name)
    return _import_files(recordings, read, dst, options, name=name, source=f"motion files: {name}")


def _read_bvh(path: pathlib.Path, options: ImportOptions, reading: Reading) -> _FileMotion:
    motion = read_motion(path, load_skeleton(options.skeleton), fps=options.fps, **reading)
    description = f"joint map {motion.joint_map}, unit {motion.unit:g} m, {motion.up} up"
    return _FileMotion(motion.positions, motion.seconds, motion.fps, description)


def import_smplx(
    src: str | os.PathLike,
    dst: str | os.PathLike,
    options: ImportOptions = _DEFAULTS,
    *,
    model: str | os.PathLike | None = None,
    up: str = joint_maps.AUTO,
    source_fps: float | None = None,
    unit: float | None = None,
) -> Report:
    """Write a corpus from one file of SMPL-X motion, or from all files in a folder and its subfolders, see
    `import_bvh`. A .npy is joint positions and needs `source_fps`.

    Audio and words lie beside the motion and have its stem. If there are none, audio files and TextGrids of that stem
    are searched for in all of `src`, for the folders of BEAT2. In a folder of Embody 3D each person of a capture is a
    recording. See `smplx.read_smplx` for the formats.

    Args:
        src: path of a .npz file, of a .npy file of joint positions, or of a folder.
        options: by default the speaker is taken from a file name of the form of BEAT2 or Seamless Interaction, else as
            described in `recordings.find_recordings`.
        model: path of an SMPL-X body model (.npz), for joints of the person's shape; None for the neutral template.
        up: axis of the files that points up, one of `body.UPS`, or "auto".
        source_fps: frames per second of the files; None uses the rate stored in each file.
        unit: metres in one unit of positions and translations; None stands for metres.

    Raises:
        UserError: there is no usable file, `dst` exists, or an option has an invalid value.
    """
    src = pathlib.Path(src)
    if up not in (joint_maps.AUTO, *UPS):
        raise UserError(f"up {up!r}; expected {joint_maps.AUTO} or one of {', '.join(UPS)}")
    check_stated(source_fps, unit)
    recordings = find_embody(src, options.speaker) if src.is_dir() else []
    if recordings and (options.audio is not None or options.words is not None):
        raise UserError(f"{shown(src)} has captures of Embody 3D with their own sound; leave out --audio and --words")
    if not recordings:
        recordings = find_recordings(
            src, (".npz", ".npy"), speaker=options.speaker, audio=options.audio, words=options.words
        )
        if src.is_dir():
            recordings = _with_folders_of_beat(recordings, src)
        if options.speaker is None:
            recordings = [_with_speaker_of_name(recording) for recording in recordings]
    body = template() if model is None else read_body_model(model)
    stated = {"source_fps": source_fps, "unit": unit, "up": None if up == joint_maps.AUTO else up}
    read = functools.partial(_read_smplx, options=options, body=body, stated=stated)
    joints = "neutral template" if model is None else f"body model {shown(pathlib.Path(model).name)}"
    name = shown(resolved(src).name)
    return _import_files(recordings, read, dst, options, name=name, source=f"SMPL-X files: {name}, {joints}")


def _read_smplx(path: pathlib.Path, options: ImportOptions, body: Body, stated: dict[str, Any]) -> _FileMotion:
    motion = read_smplx(path, load_skeleton(options.skeleton), body, fps=options.fps, **stated)
    return _FileMotion(motion.positions, motion.seconds, motion.fps, f"{motion.kind}, {motion.up} up", motion.is_good)


def _with_folders_of_beat(recordings: list[MotionRecording], root: pathlib.Path) -> list[MotionRecording]:
    """Add audio and words from other folders to recordings without them, if exactly one file there has the name.

    A file beside motion of its own name belongs to that motion alone.
    """
    owned = {(recording.path.parent, recording.path.stem) for recording in recordings}
    found: dict[tuple[str, bool], list[pathlib.Path]] = collections.defaultdict(list)
    for path in sorted(files_below(root)):
        suffix = path.suffix.lower()
        if (suffix in AUDIO_SUFFIXES or suffix == _TIMED_WORDS) and (path.parent, path.stem) not in owned:
            found[path.stem, suffix == _TIMED_WORDS].append(path)

    def with_files(recording: MotionRecording) -> MotionRecording:
        path = recording.path
        audio = recording.audio or find_audio(path)
        words = recording.words or transcripts.find(path, is_alone=recording.is_alone)
        sounds, texts = (found[path.stem, is_words] for is_words in (False, True))
        return recording._replace(
            audio=audio or (sounds[0] if len(sounds) == 1 else None),
            words=words or (texts[0] if len(texts) == 1 else None),
        )

    return [with_files(recording) for recording in recordings]


def _with_speaker_of_name(recording: MotionRecording) -> MotionRecording:
    stem = recording.path.stem
    name = _BEAT_NAME.fullmatch(stem) or SEAMLESS_NAME.fullmatch(stem)
    return recording._replace(speaker=name.group(1)) if name else recording


class _Result(NamedTuple):
    clips: list[bytes]
    report: SplitReport
    description: str = ""
    warning: str | None = None
    error: str | None = None


def _import_files(
    recordings: Sequence[MotionRecording],
    read: Callable[[pathlib.Path], _FileMotion],
    dst: str | os.PathLike,
    options: ImportOptions,
    *,
    name: str,
    source: str,
) -> Report:
    """Write a corpus of motion files, which one process per core reads; their order is kept."""
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
        for result in track(each(one, recordings), "importing the motion", "file", count):
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
        writer.metadata |= {"motion": dict(sorted(descriptions.items())), "import": report_as_json(report)}
    return report


def _import_file(
    recording: MotionRecording, read: Callable[[pathlib.Path], _FileMotion], options: ImportOptions
) -> _Result:
    try:
        motion = read(recording.path)
        audio, words = read_speech(recording, with_words=options.with_words)
        warning = compare_lengths(recording.path, motion.seconds, motion.fps, audio)
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
    return _Result([encode_clip(clip) for clip in clips], report, motion.description, warning)


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
