"""One video of the TED data as clips, by the published rule: resampling, windows, filters."""

import math
import numbers
from typing import Any, NamedTuple

import numpy as np

from ha2g_jax.data import window_filters
from ha2g_jax.data.import_report import SplitReport
from ha2g_jax.data.records import Clip, encode_clip
from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.features.text import Word
from ha2g_jax.skeleton import Skeleton

FPS = 15
TOO_SHORT, DAMAGED, NO_WINDOW = "too short", "damaged", "no window left"

_FILTERS = window_filters.TED
_FIELDS = ("words", "skeletons_3d", "audio_raw", "start_time", "end_time")
_FRAME_RATES = (1.0, 1000.0)  # of a video; they bound what a clip may declare
_AUDIO_SLACK = 1.0  # seconds that the audio of a clip may be longer or shorter than its motion


class VideoClips(NamedTuple):
    """What a video gave.

    Attributes:
        records: encoded clips that have a window.
        report: what was kept.
        damaged: one line for each clip that could not be used.
    """

    records: list[bytes]
    report: SplitReport
    damaged: list[str]


class _DamagedClipError(ValueError):
    """A clip whose fields are missing or make no sense."""


class _RawClip(NamedTuple):
    """The fields of a clip, checked: poses (n, joints, 3), audio (16000 seconds,) float32; times in the whole video."""

    poses: np.ndarray
    audio: np.ndarray
    words: tuple[Word, ...]
    start: float
    end: float


def num_joints(video: Any, name: str) -> int | None:
    """Joints of the first clip that has poses; None where none has.

    Raises:
        UserError: the value is no video of the TED data.
    """
    for clip in _clips(video, name):
        poses = clip.get("skeletons_3d") if isinstance(clip, dict) else None
        for pose in poses if isinstance(poses, (list, np.ndarray)) else ():
            if isinstance(pose, np.ndarray) and pose.ndim == 2:
                return len(pose)
    return None


def read_clips(video: Any, skeleton: Skeleton, name: str) -> VideoClips:
    """The clips of a video, with the windows that pass the filters.

    Args:
        video: what `arrow_values.deserialize` gave.
        skeleton: of the data set.
        name: of the record, for messages.

    Raises:
        UserError: the value is no video of the TED data, or has other joints than the skeleton.
    """
    report = SplitReport(videos=1)
    made, damaged = [], []
    for index, fields in enumerate(_clips(video, name)):
        report.clips += 1
        try:
            raw = _check(fields, skeleton, f"{name}, clip {index}")
        except _DamagedClipError as error:
            report.rejected[DAMAGED] += 1
            damaged.append(f"{name}, clip {index}: {error}; left out")
            continue
        positions = resample(raw.poses, raw.end - raw.start)
        choice = window_filters.choose_windows(
            positions, raw.words, skeleton, start_time=raw.start, fps=FPS, filters=_FILTERS
        )
        report.windows += len(choice.verdicts)
        report.kept += len(choice.starts)
        report.filtered.update(choice.filtered)
        if choice.starts:
            made.append(encode_clip(_make_clip(video["vid"], raw, positions, choice.starts)))
        else:
            report.rejected[NO_WINDOW if choice.verdicts else TOO_SHORT] += 1
    return VideoClips(made, report, damaged)


def resample(poses: np.ndarray, seconds: float) -> np.ndarray:
    """Poses of a clip at 15 frames a second, by linear interpolation.

    Args:
        poses: (n, joints, 3), spread evenly over the clip.
        seconds: length of the clip.

    Returns:
        (about 15 seconds, joints, 3) float64 at 0, s, 2s, ... below n frames with s = n / (15 seconds); past the last
        frame the last segment goes on. Nothing where there are not two poses.
    """
    if len(poses) < 2:
        return np.zeros((0, *poses.shape[1:]))
    times = np.arange(0, len(poses), len(poses) / (FPS * seconds))
    before = np.minimum(times.astype(int), len(poses) - 2)
    share = (times - before)[:, None, None]
    first = poses[before].astype(np.float64)
    return first + share * (poses[before + 1] - first)


def _clips(video: Any, name: str) -> list[Any]:
    if not (isinstance(video, dict) and isinstance(video.get("vid"), str) and isinstance(video.get("clips"), list)):
        raise UserError(f"{name} is not a video of the TED data, a dict with 'vid' and 'clips'; name another folder")
    return video["clips"]


def _check(fields: Any, skeleton: Skeleton, name: str) -> _RawClip:
    missing = [field for field in _FIELDS if not isinstance(fields, dict) or field not in fields]
    if missing:
        raise _DamagedClipError(f"without {', '.join(missing)}")
    poses = _poses(fields["skeletons_3d"], skeleton, name)
    start, end = (_number(fields[field], field) for field in ("start_time", "end_time"))
    if not _FRAME_RATES[0] * (end - start) <= len(poses) <= _FRAME_RATES[1] * (end - start):
        raise _DamagedClipError(f"{len(poses)} frames in {end - start:g} s")
    return _RawClip(poses, _audio(fields["audio_raw"], end - start), _words(fields["words"]), start, end)


def _poses(frames: Any, skeleton: Skeleton, name: str) -> np.ndarray:
    """(n, joints, 3); one array, or one a frame."""
    if isinstance(frames, list) and all(isinstance(frame, np.ndarray) for frame in frames):
        if len({frame.shape for frame in frames}) > 1:
            raise _DamagedClipError("frames with different numbers of joints")
        frames = np.stack(frames) if frames else np.zeros((0, skeleton.num_joints, 3))
    if not isinstance(frames, np.ndarray) or frames.dtype.kind != "f" or frames.ndim != 3 or frames.shape[2] != 3:
        raise _DamagedClipError("poses that are not (frames, joints, 3) numbers")
    if frames.shape[1] != skeleton.num_joints:
        raise UserError(
            f"{name} has {frames.shape[1]} joints, not the {skeleton.num_joints} of {skeleton.name} "
            "that other clips have; import each data set by itself"
        )
    if not np.isfinite(frames).all():
        raise _DamagedClipError("poses that are not finite")
    return frames


def _audio(samples: Any, seconds: float) -> np.ndarray:
    """(16000 seconds,) float32 in [-1, 1], cut or filled up with silence."""
    if not isinstance(samples, np.ndarray) or samples.ndim != 1 or samples.dtype.kind != "f":
        raise _DamagedClipError("audio that is not a row of numbers")
    if abs(len(samples) / SAMPLE_RATE - seconds) > _AUDIO_SLACK:
        raise _DamagedClipError(f"{len(samples) / SAMPLE_RATE:.2f} s of audio for {seconds:.2f} s of motion")
    if not np.isfinite(samples).all():
        raise _DamagedClipError("audio that is not finite")
    audio = np.zeros(round(seconds * SAMPLE_RATE), np.float32)
    audio[: len(samples)] = samples[: len(audio)]
    return np.clip(audio, -1, 1)


def _words(words: Any) -> tuple[Word, ...]:
    if not isinstance(words, (list, tuple)):
        raise _DamagedClipError("words that are not a list")
    for word in words:
        if not isinstance(word, (list, tuple)) or len(word) != 3 or not isinstance(word[0], str):
            raise _DamagedClipError("words that are not word, start, end")
    read = (Word(text, _number(start, "a word"), _number(end, "a word")) for text, start, end in words)
    return tuple(sorted(read, key=lambda word: word.start))


def _number(value: Any, field: str) -> float:
    if not isinstance(value, numbers.Real) or not math.isfinite(value):
        raise _DamagedClipError(f"no time as {field}")
    return float(value)


def _make_clip(vid: str, raw: _RawClip, positions: np.ndarray, starts: tuple[int, ...]) -> Clip:
    seconds = len(raw.audio) / SAMPLE_RATE
    words = (
        Word(word.text, max(word.start - raw.start, 0.0), min(word.end - raw.start, seconds))
        for word in raw.words
        if word.start < raw.end and word.end > raw.start and word.text.strip()
    )
    return Clip(
        # Not a number: a video has clips in several splits, which number theirs by themselves.
        id=f"{vid}-{raw.start:.2f}",
        speaker=vid,
        audio=raw.audio,
        words=tuple(word for word in words if word.start <= word.end),
        positions=positions,
        reference_frames=None,
        source_time=raw.start,
        window_starts=starts,
        talk=vid,
    )
