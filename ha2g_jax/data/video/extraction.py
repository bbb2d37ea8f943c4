"""One video becomes clips (HA2G, Appendix A): shots, poses, the three conditions, words and reference frames."""

import dataclasses
import pathlib
from typing import NamedTuple

import numpy as np

from ha2g_jax.data import recording, transcripts
from ha2g_jax.data.import_report import SplitReport
from ha2g_jax.data.recording import Recording
from ha2g_jax.data.records import Clip, encode_clip
from ha2g_jax.data.video import frames, overlay, pose, selection, shots, smoothing
from ha2g_jax.data.video.pose import Poses
from ha2g_jax.data.video.settings import VideoSettings
from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import SAMPLE_RATE, read_audio
from ha2g_jax.features.text import Word
from ha2g_jax.skeleton import load_skeleton

SKELETON = "ted_expressive"
# Of what `extract` makes; a new number makes a build that is resumed do its videos anew.
VERSION = 1


class Extraction(NamedTuple):
    """What one video gives.

    Attributes:
        records: its clips, encoded, in order of time.
        report: counts of one video.
        frames: pictures of the video.
        frames_with_both_hands: those in which wrists and fingers of both hands are seen.
        seconds: length of the pictures.
        shots: number of shots.
    """

    records: list[bytes]
    report: SplitReport
    frames: int
    frames_with_both_hands: int
    seconds: float
    shots: int


class _Source(NamedTuple):
    """A video taken apart; times in seconds of its sound."""

    video: pathlib.Path
    talk: str
    speaker: str
    audio: np.ndarray
    words: tuple[Word, ...]
    times: np.ndarray
    poses: Poses


def extract(
    video: pathlib.Path,
    settings: VideoSettings,
    *,
    talk: str,
    speaker: str,
    overlay_path: pathlib.Path | None = None,
) -> Extraction:
    """The clips of one video; the same video and settings give the same bytes anywhere.

    Args:
        video: a file with pictures and sound, and the transcript beside it unless `settings.recognise` is set.
        settings: every threshold and choice.
        talk: name of the recording, unique in the corpus.
        speaker: name of who speaks.
        overlay_path: where to write the video with the skeleton drawn on the speaker; nowhere if None.

    Raises:
        UserError: no sound, no pictures, no words, or no poses can be had.
    """
    # First what is quick and may fail.
    audio = read_audio(video)
    times = frames.frame_times(video)
    words = transcripts.words_of(audio, transcripts.find(video), recognise=settings.recognise)
    spans = shots.find_shots(video, threshold=settings.shot_threshold)
    poses = pose.estimate(video, command=settings.pose_command)
    if len(poses.positions) != len(times):
        raise UserError(
            f"{video} has {len(times)} pictures, but poses of {len(poses.positions)} came back; "
            "expected one of each picture, in order"
        )
    if overlay_path is not None:
        overlay.write_overlay(overlay_path, video, poses.image_points, poses.confidence)

    source = _Source(video, talk, speaker, audio, words, times, poses)
    clips: list[Clip] = []
    report = SplitReport()
    for start, end in spans:
        shot, reason = _read_shot(source, start, end, settings)
        if shot is None:
            report.rejected[reason] += 1
            continue
        of_shot, counts = recording.to_clips(
            shot,
            load_skeleton(SKELETON),
            fps=settings.fps,
            filters=settings.filters,
            max_seconds=settings.max_seconds,
            first=report.clips,
        )
        clips += of_shot
        report += counts
    hands = poses.confidence[:, selection.hand_joints(load_skeleton(SKELETON))]
    return Extraction(
        records=[encode_clip(clip) for clip in _with_reference_frames(clips, source, settings)],
        report=dataclasses.replace(report, videos=1),
        frames=len(times),
        frames_with_both_hands=int(selection.seen(hands, settings.min_confidence).sum()),
        seconds=round(float(times[-1] - times[0]) + _frame_seconds(times), 3),
        shots=len(spans),
    )


def _read_shot(source: _Source, start: int, end: int, settings: VideoSettings) -> tuple[Recording | None, str]:
    """The recording of frames [start, end), or None and the condition that it does not fulfil."""
    # Pictures before and after the sound have no speech; nor may a time that a damaged file states become many frames.
    with_sound = np.searchsorted(source.times, [0, len(source.audio) / SAMPLE_RATE])
    start, end = max(start, int(with_sound[0])), min(end, int(with_sound[1]))
    times, confidence = source.times[start:end], source.poses.confidence[start:end]
    if len(times) < 2:
        return None, selection.TOO_SHORT
    fps = 1 / _frame_seconds(times)
    reason = selection.too_short(len(times), fps, settings.min_seconds) or selection.unseen(
        confidence, settings.min_confidence, settings.min_visible
    )
    if reason:
        return None, reason
    positions = smoothing.clean(
        source.poses.positions[start:end], confidence, fps, max_gap=settings.max_gap, cutoff=settings.cutoff
    )
    at = times[0] + np.arange(int((times[-1] - times[0]) * settings.fps + 1e-6) + 1) / settings.fps
    positions, confidence = resample(positions, times, at), resample(confidence, times, at)
    reason = selection.still(positions, load_skeleton(SKELETON), settings.min_motion)
    if reason:
        return None, reason
    first, last = (round(time * SAMPLE_RATE) for time in (times[0], at[-1] + 1 / settings.fps))
    return Recording(
        talk=source.talk,
        speaker=source.speaker,
        audio=source.audio[first:last],
        words=tuple(Word(word.text, word.start - times[0], word.end - times[0]) for word in source.words),
        positions=positions,
        confidence=confidence,
        source_time=float(times[0]),
    ), ""


def resample(values: np.ndarray, times: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Values (T, ...) of rising `times` (T,), linearly interpolated at times (N,) within them: (N, ...) float32."""
    after = np.clip(np.searchsorted(times, at, side="right"), 1, len(times) - 1)
    weight = np.clip((at - times[after - 1]) / (times[after] - times[after - 1]), 0, 1)
    weight = weight.reshape(-1, *[1] * (values.ndim - 1))
    return ((1 - weight) * values[after - 1] + weight * values[after]).astype(np.float32)


def _frame_seconds(times: np.ndarray) -> float:
    """Mean time that a picture is shown; an assumed one for a single picture."""
    return float(times[-1] - times[0]) / (len(times) - 1) if len(times) > 1 else 1 / 25


def _with_reference_frames(clips: list[Clip], source: _Source, settings: VideoSettings) -> list[Clip]:
    """The clips with images of the speaker: "the first M reference frame images of a clip" (HA2G, Appendix B)."""
    if not settings.num_reference_frames:
        return clips
    skeleton = load_skeleton(SKELETON)
    width, height = frames.picture_size(source.video)
    wanted: list[tuple[int, frames.Box]] = []
    for clip in clips:
        at = clip.source_time + np.arange(settings.num_reference_frames) / settings.fps
        nearest = np.abs(source.times[:, None] - at).argmin(axis=0)
        box = frames.speaker_box(source.poses.image_points[nearest], skeleton, width, height)
        wanted += [(int(frame), box) for frame in nearest]
    images = frames.crops(source.video, wanted, settings.image_size)
    of_clips = [
        images[i : i + settings.num_reference_frames] for i in range(0, len(images), settings.num_reference_frames)
    ]
    return [
        dataclasses.replace(clip, reference_frames=np.stack(of_clip))
        for clip, of_clip in zip(clips, of_clips, strict=True)
    ]
