"""A recording of a person who speaks and moves, from motion capture or video, and its division into clips."""

import dataclasses
from typing import NamedTuple

import numpy as np

from ha2g_jax.data.import_report import SplitReport
from ha2g_jax.data.records import Clip
from ha2g_jax.data.window_filters import MOCAP, WindowFilters, choose_windows
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.features.text import Word
from ha2g_jax.skeleton import Skeleton

MAX_SECONDS = 20.0  # length of a clip: a reader decodes whole clips, and a batch has windows of many clips

TOO_SHORT, NO_WINDOW = "too short", "no window left"

# Earliest and latest point at which a piece may be cut, as fractions of its length.
_EARLIEST, _LATEST = 0.3, 0.7


class Recording(NamedTuple):
    """Speech and motion of one file, or of one shot of a video.

    Attributes:
        name: name of the recording, unique in its corpus; the shots of a video have the same name.
        speaker: name of the speaker.
        audio: (S,) float32, mono, 16 kHz.
        words: words in order of time, in seconds from the start of the audio.
        positions: (T, joints, 3) in metres, in the axes of the skeleton, at the corpus' frame rate.
        confidence: (T, joints) float32 in [0, 1], None if the positions were not estimated.
        reference_images: (M, 224, 224, 3) uint8 images of the speaker, None if there are none.
        start: start of the shot in its file, in seconds.
    """

    name: str
    speaker: str
    audio: np.ndarray
    words: tuple[Word, ...]
    positions: np.ndarray
    confidence: np.ndarray | None = None
    reference_images: np.ndarray | None = None
    start: float = 0.0


def to_clips(
    recording: Recording,
    skeleton: Skeleton,
    *,
    fps: float = 15,
    filters: WindowFilters = MOCAP,
    max_seconds: float = MAX_SECONDS,
    first: int = 0,
) -> tuple[list[Clip], SplitReport]:
    """Cut a recording into clips at its longest pauses, and keep the clips that have a window.

    Args:
        recording: recording, used up to the end of the shorter of its motion and its audio.
        skeleton: skeleton of the positions.
        fps: frames per second of the positions.
        filters: conditions that a window must fulfil.
        max_seconds: maximum length of a clip in seconds.
        first: number of the first clip, for a recording of several shots; clips are named NAME-NUMBER.

    Returns:
        The clips in order of time, and the counts of one recording. The numbers of clips that are left out stay unused.
    """
    num_frames = min(len(recording.positions), int(len(recording.audio) / SAMPLE_RATE * fps + 0.5))
    pieces = _pieces(recording.words, 0, num_frames, fps, max_seconds * fps)
    report, clips = SplitReport(videos=1, clips=len(pieces)), []
    for number, (start, end) in enumerate(pieces, start=first):
        clip = _cut(recording, start, end, fps, number)
        choice = choose_windows(clip.positions, clip.words, skeleton, fps=fps, filters=filters)
        report.windows += len(choice.verdicts)
        report.kept += len(choice.starts)
        report.filtered += choice.filtered
        if choice.starts:
            clips.append(dataclasses.replace(clip, window_starts=choice.starts))
        else:
            report.rejected[NO_WINDOW if choice.verdicts else TOO_SHORT] += 1
    return clips, report


def cut(recording: Recording, start: int, end: int, fps: float) -> Recording:
    """Return the part of a recording of frames [start, end), with the words that start in it.

    Args:
        recording: recording.
        start: first frame.
        end: last frame + 1.
        fps: frames per second of the positions.
    """
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


def _cut(recording: Recording, start: int, end: int, fps: float, number: int) -> Clip:
    """Return the clip of frames [start, end), without windows; a word belongs to the clip in which it starts."""
    part = cut(recording, start, end, fps)
    return Clip(
        id=f"{part.name}-{number}",
        speaker=part.speaker,
        audio=part.audio,
        words=part.words,
        positions=part.positions,
        reference_images=part.reference_images,
        recording_start=part.start,
        window_starts=(),
        recording=part.name,
        confidence=part.confidence,
    )
