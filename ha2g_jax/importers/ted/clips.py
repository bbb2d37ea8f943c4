"""Clips of one video of the TED data, by the published procedure: resampling, windows, filters."""

import math
import numbers
from typing import Any, NamedTuple

import numpy as np

from ha2g_jax.data.recording import DAMAGED, NO_WINDOW, TOO_SHORT, SplitReport, choose_windows
from ha2g_jax.data.records import Clip, encode_clip
from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.features.text import Word
from ha2g_jax.skeleton import Skeleton

FPS = 15

_FIELDS = ("words", "skeletons_3d", "audio_raw", "start_time", "end_time")
_FRAME_RATES = (1.0, 1000.0)  # plausible frame rates of a video, which limit the length that a clip may declare
_AUDIO_SLACK = 1.0  # seconds by which the audio of a clip may be longer or shorter than its motion


class VideoClips(NamedTuple):
    """The clips of one video that have a window, encoded, the counts, and a line for each clip that is damaged."""

    records: list[bytes]
    report: SplitReport
    damaged: list[str]


class _DamagedClipError(ValueError):
    """Error for a clip with missing or invalid fields."""


class _RawClip(NamedTuple):
    """Checked fields of a clip: poses (n, joints, 3), audio (16000 * seconds,) float32; times in the whole video."""

    poses: np.ndarray
    audio: np.ndarray
    words: tuple[Word, ...]
    start: float
    end: float


def num_joints(video: Any, name: str) -> int | None:
    """Return the number of joints of the first clip of a video (see `read_clips`) that has poses, None if no clip has.

    Raises:
        UserError: the value is not a video of the TED data.
    """
    for clip in _clips(video, name):
        poses = clip.get("skeletons_3d") if isinstance(clip, dict) else None
        for pose in poses if isinstance(poses, (list, np.ndarray)) else ():
            if isinstance(pose, np.ndarray) and pose.ndim == 2:
                return len(pose)
    return None


def read_clips(video: Any, skeleton: Skeleton, name: str) -> VideoClips:
    """Read the clips of a video, a value that `arrow.deserialize` returns, with the windows that pass the filters.

    Raises:
        UserError: the value is not a video of the TED data, or has other joints than the skeleton.
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
        choice = choose_windows(positions, raw.words, skeleton, start_time=raw.start)
        report.windows += len(choice.verdicts)
        report.kept += len(choice.starts)
        report.filtered.update(choice.filtered)
        if choice.starts:
            made.append(encode_clip(_make_clip(video["vid"], raw, positions, choice.starts)))
        else:
            report.rejected[NO_WINDOW if choice.verdicts else TOO_SHORT] += 1
    return VideoClips(made, report, damaged)


def resample(poses: np.ndarray, seconds: float) -> np.ndarray:
    """Resample poses (n, joints, 3), evenly spaced over a clip, to 15 frames per second by linear interpolation.

    Returns:
        (about 15 * seconds, joints, 3) float64 at the fractional frames 0, s, 2 s, ... below n, s = n / (15 * seconds);
        extrapolated past the last frame. Empty if there are fewer than two poses.
    """
    if len(poses) < 2:
        return np.zeros((0, *poses.shape[1:]))
    times = np.arange(0, len(poses), len(poses) / (FPS * seconds))
    before = np.minimum(times.astype(int), len(poses) - 2)
    weight = (times - before)[:, None, None]
    first = poses[before].astype(np.float64)
    return first + weight * (poses[before + 1] - first)


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
    """Check and return the poses (n, joints, 3), given as one array or as one per frame."""
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
    """Check and return the audio (16000 * seconds,) float32 in [-1, 1], cut or padded with silence."""
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
        # Named by time, because a video has clips in several splits, each of which numbers its clips from 0.
        id=f"{vid}-{raw.start:.2f}",
        speaker=vid,
        audio=raw.audio,
        words=tuple(word for word in words if word.start <= word.end),
        positions=positions,
        reference_images=None,
        recording_start=raw.start,
        window_starts=starts,
        recording=vid,
    )
