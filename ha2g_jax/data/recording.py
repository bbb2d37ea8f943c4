"""Cutting of recordings into clips, at pauses, and choice of the windows that pass the filters of the TED data."""

import collections
import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from ha2g_jax.data.records import Clip, frames_at
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.features.text import Word
from ha2g_jax.progress import counted
from ha2g_jax.skeleton import Skeleton

KEPT = "kept"
TOO_FEW_WORDS = "too_few_words"
MEAN_POSE = "pose"
SPINE_ANGLE = "spine angle"
MOTION = "motion"
REASONS = (TOO_FEW_WORDS, MEAN_POSE, SPINE_ANGLE, MOTION)

_UPRIGHT = np.array([0.0, -1.0, 0.0])  # y points down

MAX_SECONDS = 20.0  # length of a clip; it is short because whole clips are decoded and a batch has windows of many

OF_CLIPS = TOO_SHORT, NO_WINDOW, DAMAGED = ("too short", "no window left", "damaged")  # reasons to leave out a clip
UNUSABLE = "unusable recording"

# Earliest and latest point at which a piece may be cut, as fractions of its length.
_EARLIEST, _LATEST = 0.3, 0.7


@dataclasses.dataclass
class SplitReport:
    """Counts of one split; the sum of two reports is a report.

    Attributes:
        videos: number of recordings read: videos, motion captures or entries of a database.
        clips: number of clips that the recordings have, or that were cut from them.
        windows, kept: numbers of windows that were examined, and of those that passed all filters.
        filtered: number of windows that failed a filter, by reason.
        rejected: number of clips or shots without any window, and of recordings that could not be read, by reason.
    """

    videos: int = 0
    clips: int = 0
    windows: int = 0
    kept: int = 0
    filtered: collections.Counter[str] = dataclasses.field(default_factory=collections.Counter)
    rejected: collections.Counter[str] = dataclasses.field(default_factory=collections.Counter)

    def __add__(self, other: "SplitReport") -> "SplitReport":
        return SplitReport(
            self.videos + other.videos,
            self.clips + other.clips,
            self.windows + other.windows,
            self.kept + other.kept,
            _sum(self.filtered, other.filtered),
            _sum(self.rejected, other.rejected),
        )

    def as_json(self) -> dict[str, Any]:
        """Return the counts as plain values for JSON; "rejected" only if something was rejected."""
        counts = dataclasses.asdict(self) | {"filtered": dict(self.filtered), "rejected": dict(self.rejected)}
        return counts if self.rejected else {name: count for name, count in counts.items() if name != "rejected"}

    @classmethod
    def from_json(cls, counts: dict[str, Any]) -> "SplitReport":
        """Make a report from counts that `as_json` returned."""
        filtered, rejected = (collections.Counter(counts.get(name, {})) for name in ("filtered", "rejected"))
        return dataclasses.replace(cls(**counts), filtered=filtered, rejected=rejected)


Report: TypeAlias = dict[str, SplitReport]


def report_as_json(report: Report) -> dict[str, Any]:
    return {split: counts.as_json() for split, counts in report.items()}


def report_from_json(values: dict[str, Any]) -> Report:
    """Make a report from values that `report_as_json` returned."""
    return {split: SplitReport.from_json(counts) for split, counts in values.items()}


def report_as_table(report: Report) -> str:
    """Format a report as text: one line per split, followed by one line per reason."""
    lines = [f"{'split':<12}{'videos':>8}{'clips':>8}{'windows':>10}{'kept':>10}"]
    for split, counts in report.items():
        lines.append(f"{split:<12}{counts.videos:>8}{counts.clips:>8}{counts.windows:>10}{counts.kept:>10}")
        left_out = [(counted(count, "window"), reason) for reason, count in counts.filtered.items() if count]
        left_out += [(counted(count, _noun(reason)), reason) for reason, count in counts.rejected.items() if count]
        lines += [f"  {number} left out: {reason}" for number, reason in left_out]
    return "\n".join(lines)


def _noun(reason: str) -> str:
    """Return what was rejected for a reason."""
    return "clip" if reason in OF_CLIPS else "recording" if reason == UNUSABLE else "shot"


def _sum(first: collections.Counter[str], second: collections.Counter[str]) -> collections.Counter[str]:
    # Counter's own + drops reasons with a count of 0.
    return collections.Counter({name: first[name] + second[name] for name in dict.fromkeys([*first, *second])})


class WindowFilters(NamedTuple):
    """Conditions that a window must fulfil; None switches a filter off. Frames are at 15 fps.

    Attributes:
        min_words: minimum number of words that overlap the window.
        min_pose_distance: minimum of the mean |pose - mean pose| over frames, joints and axes, in metres; below it the
            pose estimator has fallen back to its mean pose.
        max_spine_angle: maximum angle between the spine and upright in any frame, in degrees.
        max_mean_spine_angle: maximum of the mean over the frames of that angle, in degrees.
        min_wrist_variance: minimum variance of a wrist's position, in square metres; a window fails if both wrists are
            below it.
        num_frames, stride: length of a window, and distance between the starts of two.
    """

    min_words: int | None = 2
    min_pose_distance: float | None = 0.02
    max_spine_angle: float | None = 30.0
    max_mean_spine_angle: float | None = 20.0
    min_wrist_variance: float | None = 0.0014
    num_frames: int = 42
    stride: int = 10


# 42 frames = round(34 * 1.25): the first 34 frames of each window that passes are the training sample.
TED = WindowFilters()
# In motion capture, a person who leans or stands in the mean pose is not a tracking error.
MOCAP = WindowFilters(min_pose_distance=None, max_spine_angle=None, max_mean_spine_angle=None, num_frames=34)


class WindowChoice(NamedTuple):
    """First frames of the windows of a clip that are kept, and the verdict on each window: `KEPT` or a reason."""

    starts: tuple[int, ...]
    verdicts: tuple[str, ...]

    @property
    def filtered(self) -> collections.Counter[str]:
        """Number of dropped windows by reason, without reasons that dropped none."""
        return collections.Counter(verdict for verdict in self.verdicts if verdict != KEPT)


def choose_windows(
    positions: np.ndarray,
    words: Sequence[Word],
    skeleton: Skeleton,
    *,
    start_time: float = 0.0,
    fps: float = 15,
    filters: WindowFilters = TED,
) -> WindowChoice:
    """Apply the filters to the windows of a clip; the verdict on a window is the first filter that it fails.

    The filters in order: too few words, then as in the TED data (HA2G, Appendix A) pose, spine angle and motion. Length
    and stride of windows are at 15 fps; at other rates they take as much time. A clip shorter than a window has none.

    Args:
        positions: (T, joints, 3) in metres, y down, finite; not recentred.
        words: in the clock of `start_time`, the time of the first frame in seconds. Without any, `min_words` drops
            every window: importers that have no transcript switch it off.
    """
    length, stride = (frames_at(frames, fps) for frames in (filters.num_frames, filters.stride))
    filters = filters._replace(num_frames=length, stride=stride)
    starts = np.arange(0, len(positions) - length + 1, stride)
    verdicts = np.full(len(starts), KEPT, object)
    if len(starts):
        # From the last filter to the first, so that the verdict is the first filter that a window fails.
        for reason, is_failed in (
            (MOTION, _too_still(positions, starts, skeleton, filters)),
            (SPINE_ANGLE, _too_tilted(positions, starts, skeleton, filters)),
            (MEAN_POSE, _too_near_mean_pose(positions, starts, skeleton, filters)),
            (TOO_FEW_WORDS, _too_few_words(words, starts, start_time, fps, filters)),
        ):
            verdicts[is_failed] = reason
    return WindowChoice(tuple(starts[verdicts == KEPT].tolist()), tuple(verdicts.tolist()))


def _too_few_words(
    words: Sequence[Word], starts: np.ndarray, start_time: float, fps: float, filters: WindowFilters
) -> np.ndarray:
    if filters.min_words is None:
        return np.zeros(len(starts), bool)
    window_starts, window_ends = start_time + starts / fps, start_time + (starts + filters.num_frames) / fps
    word_starts, word_ends = np.array([word.start for word in words]), np.array([word.end for word in words])
    inside = (word_starts < window_ends[:, None]) & (word_ends > window_starts[:, None])
    return inside.sum(axis=1) < filters.min_words


def _too_near_mean_pose(
    positions: np.ndarray, starts: np.ndarray, skeleton: Skeleton, filters: WindowFilters
) -> np.ndarray:
    if filters.min_pose_distance is None:
        return np.zeros(len(starts), bool)
    distances = np.abs(positions - skeleton.mean_pose).mean(axis=(1, 2))
    return _windows(distances, starts, filters).mean(axis=1) < filters.min_pose_distance


def _too_tilted(positions: np.ndarray, starts: np.ndarray, skeleton: Skeleton, filters: WindowFilters) -> np.ndarray:
    spine = positions[:, skeleton.joint("neck")] - positions[:, skeleton.joint("spine")]
    length = np.maximum(np.linalg.norm(spine, axis=1), np.finfo(np.float32).tiny)
    angles = np.rad2deg(np.arccos(np.clip(spine @ _UPRIGHT / length, -1, 1)))
    in_window = _windows(angles, starts, filters)
    is_failed = np.zeros(len(starts), bool)
    if filters.max_spine_angle is not None:
        is_failed |= in_window.max(axis=1) > filters.max_spine_angle
    if filters.max_mean_spine_angle is not None:
        is_failed |= in_window.mean(axis=1) > filters.max_mean_spine_angle
    return is_failed


def _too_still(positions: np.ndarray, starts: np.ndarray, skeleton: Skeleton, filters: WindowFilters) -> np.ndarray:
    if filters.min_wrist_variance is None:
        return np.zeros(len(starts), bool)
    wrists = positions[:, [skeleton.joint("left_wrist"), skeleton.joint("right_wrist")]].astype(np.float64)
    variances = _windows(wrists, starts, filters).var(axis=1).sum(axis=-1)  # (windows, wrists)
    return (variances < filters.min_wrist_variance).all(axis=1)


def _windows(values: np.ndarray, starts: np.ndarray, filters: WindowFilters) -> np.ndarray:
    return values[starts[:, None] + np.arange(filters.num_frames)]


class Recording(NamedTuple):
    """Speech and motion of one file, or of one shot of a video.

    Attributes:
        name: name of the recording, unique in its corpus; the shots of a video have the same name.
        audio: (S,) float32, mono, 16 kHz.
        words: words in order of time, in seconds from the start of the audio.
        positions: (T, joints, 3) in metres, in the axes of the skeleton, at the corpus' frame rate.
        confidence: (T, joints) float32 in [0, 1], None if the positions were not estimated.
        start: start of the shot in its file, in seconds.
    """

    name: str
    speaker: str
    audio: np.ndarray
    words: tuple[Word, ...]
    positions: np.ndarray
    confidence: np.ndarray | None = None
    start: float = 0.0


def seen(confidence: np.ndarray, min_confidence: float) -> np.ndarray:
    """Return (T,) bool, whether all keypoints (T, keypoints) of an image have at least this confidence, above 0."""
    return np.all((confidence >= min_confidence) & (confidence > 0), axis=1)


def to_clips(
    recording: Recording,
    skeleton: Skeleton,
    *,
    fps: float = 15,
    filters: WindowFilters = MOCAP,
    max_seconds: float = MAX_SECONDS,
    first: int = 0,
) -> tuple[list[Clip], SplitReport]:
    """Cut a recording at its longest pauses, and return the clips that have a window, and a report of the recording.

    The clips, in order of time, are named NAME-NUMBER. Numbers start at `first`, for a recording of several shots, and
    those of clips that are left out stay unused.
    """
    num_frames = min(len(recording.positions), int(len(recording.audio) / SAMPLE_RATE * fps + 0.5))
    pieces = _pieces(recording.words, 0, num_frames, fps, max_seconds * fps)
    report, clips = SplitReport(videos=1, clips=len(pieces)), []
    for number, (start, end) in enumerate(pieces, start=first):
        part = cut(recording, start, end, fps)
        choice = choose_windows(part.positions, part.words, skeleton, fps=fps, filters=filters)
        report.windows += len(choice.verdicts)
        report.kept += len(choice.starts)
        report.filtered += choice.filtered
        if choice.starts:
            clips.append(_clip(part, number, choice.starts))
        else:
            report.rejected[NO_WINDOW if choice.verdicts else TOO_SHORT] += 1
    return clips, report


def cut(recording: Recording, start: int, end: int, fps: float) -> Recording:
    """Return the part of a recording of frames [start, end) at `fps`, with the words that start in it."""
    begin, finish = start / fps, end / fps
    words = tuple(
        Word(word.text, word.start - begin, min(word.end, finish) - begin)
        for word in recording.words
        if begin <= word.start < finish
    )
    return recording._replace(
        audio=recording.audio[round(begin * SAMPLE_RATE) : round(finish * SAMPLE_RATE)],
        words=words,
        positions=recording.positions[start:end],
        confidence=None if recording.confidence is None else recording.confidence[start:end],
        start=recording.start + begin,
    )


def _pieces(words: tuple[Word, ...], start: int, end: int, fps: float, longest: float) -> list[tuple[int, int]]:
    """Divide frames [start, end) into pieces of at most `longest` frames, cut in the middle of the longest pauses."""
    if end - start <= longest:
        return [(start, end)]
    early, late = (start + fraction * (end - start) for fraction in (_EARLIEST, _LATEST))
    ends = [early, *(fps * word.end for word in words)]
    starts = [*(fps * word.start for word in words), late]
    pauses = [(max(a, early), min(b, late)) for a, b in zip(ends, starts, strict=True)]
    before, after = max(pauses, key=lambda pause: pause[1] - pause[0])
    if before > after:  # one word covers the whole range
        before = after = (start + end) / 2
    cut = min(max(round((before + after) / 2), start + 1), end - 1)
    return _pieces(words, start, cut, fps, longest) + _pieces(words, cut, end, fps, longest)


def _clip(part: Recording, number: int, window_starts: tuple[int, ...]) -> Clip:
    return Clip(
        id=f"{part.name}-{number}",
        speaker=part.speaker,
        audio=part.audio,
        words=part.words,
        positions=part.positions,
        reference_images=None,
        recording_start=part.start,
        window_starts=window_starts,
        recording=part.name,
        confidence=part.confidence,
    )
