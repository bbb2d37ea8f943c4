"""Extraction of the clips of one video (HA2G, Appendix A): shots, poses, three conditions, words and images."""

import dataclasses
import pathlib
from typing import NamedTuple

import numpy as np

from ha2g_jax.data.recording import Recording, SplitReport, to_clips
from ha2g_jax.data.records import Clip, encode_clip
from ha2g_jax.errors import UserError
from ha2g_jax.features import words as transcripts
from ha2g_jax.features.audio import SAMPLE_RATE, read_audio
from ha2g_jax.features.text import Word
from ha2g_jax.files.reading import shown
from ha2g_jax.importers.video import images, overlay, pose, selection, shots
from ha2g_jax.importers.video.pose import Poses
from ha2g_jax.importers.video.recordings import VideoRecording
from ha2g_jax.importers.video.settings import VideoSettings
from ha2g_jax.skeleton import load_skeleton

SKELETON = "ted_expressive"
# Version of the results of `extract`; a new number makes a continued build read its videos again.
VERSION = 1


class Extraction(NamedTuple):
    """The clips of one video.

    Attributes:
        records: encoded clips in order of time.
        report: counts of one video.
        frames: number of images of the video.
        frames_with_both_hands: number of images in which wrists and fingers of both hands are seen.
        seconds: length of the video in seconds.
        shots: number of shots.
    """

    records: list[bytes]
    report: SplitReport
    frames: int
    frames_with_both_hands: int
    seconds: float
    shots: int


class _Video(NamedTuple):
    """Contents of a video; times in seconds from the start of its audio."""

    recording: VideoRecording
    audio: np.ndarray
    words: tuple[Word, ...]
    times: np.ndarray
    poses: Poses


def extract(
    recording: VideoRecording,
    settings: VideoSettings,
    *,
    overlay_path: pathlib.Path | None = None,
) -> Extraction:
    """Extract the clips of one video; equal videos and settings give equal bytes on any machine.

    Args:
        recording: the video, which must have a transcript beside it unless `settings.recognise` is set.
        settings: all thresholds and choices.
        overlay_path: path for a copy of the video with the skeleton drawn on the speaker; None for no copy.

    Returns:
        The clips and counts.

    Raises:
        UserError: the audio, the images, the words or the poses cannot be obtained.
    """
    # First the steps that are fast and may fail.
    video = recording.video
    audio = read_audio(video)
    times = images.image_times(video)
    words = transcripts.words_of(audio, recording.transcript, recognise=settings.recognise)
    spans = shots.find_shots(video, threshold=settings.shot_threshold)
    poses = pose.estimate(video, command=settings.pose_command)
    if len(poses.positions) != len(times):
        raise UserError(
            f"{shown(video)} has {len(times)} images, but the pose estimator returned {len(poses.positions)} poses; "
            "expected one for each image, in order"
        )
    if overlay_path is not None:
        overlay.write_overlay(overlay_path, video, poses.image_points, poses.confidence)

    content = _Video(recording, audio, words, times, poses)
    clips: list[Clip] = []
    report = SplitReport()
    for start, end in spans:
        shot, reason = _read_shot(content, start, end, settings)
        if shot is None:
            report.rejected[reason] += 1
            continue
        of_shot, counts = to_clips(
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
        records=[encode_clip(clip) for clip in _with_images(clips, content, settings)],
        report=dataclasses.replace(report, videos=1),
        frames=len(times),
        frames_with_both_hands=int(selection.seen(hands, settings.min_confidence).sum()),
        seconds=round(float(times[-1] - times[0]) + _image_seconds(times), 3),
        shots=len(spans),
    )


def _read_shot(video: _Video, start: int, end: int, settings: VideoSettings) -> tuple[Recording | None, str]:
    """Return the recording of images [start, end), or None and the condition that the shot does not fulfil."""
    from ha2g_jax.importers.video import smoothing

    # Images before and after the audio have no speech, and a wrong time in a damaged file must not give many frames.
    with_sound = np.searchsorted(video.times, [0, len(video.audio) / SAMPLE_RATE])
    start, end = max(start, int(with_sound[0])), min(end, int(with_sound[1]))
    times, confidence = video.times[start:end], video.poses.confidence[start:end]
    if len(times) < 2:
        return None, selection.TOO_SHORT
    fps = 1 / _image_seconds(times)
    reason = selection.too_short(len(times), fps, settings.min_seconds) or selection.unseen(
        confidence, settings.min_confidence, settings.min_visible
    )
    if reason:
        return None, reason
    positions = smoothing.clean(
        video.poses.positions[start:end], confidence, fps, max_gap=settings.max_gap, cutoff=settings.cutoff
    )
    at = times[0] + np.arange(int((times[-1] - times[0]) * settings.fps + 1e-6) + 1) / settings.fps
    positions, confidence = resample(positions, times, at), resample(confidence, times, at)
    reason = selection.still(positions, load_skeleton(SKELETON), settings.min_motion)
    if reason:
        return None, reason
    first, last = (round(time * SAMPLE_RATE) for time in (times[0], at[-1] + 1 / settings.fps))
    return Recording(
        name=video.recording.name,
        speaker=video.recording.speaker,
        audio=video.audio[first:last],
        words=tuple(Word(word.text, word.start - times[0], word.end - times[0]) for word in video.words),
        positions=positions,
        confidence=confidence,
        start=float(times[0]),
    ), ""


def resample(values: np.ndarray, times: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Interpolate values linearly at other times.

    Args:
        values: (T, ...) values.
        times: (T,) times of the values in seconds, ascending.
        at: (N,) times of the result in seconds.

    Returns:
        (N, ...) float32.
    """
    after = np.clip(np.searchsorted(times, at, side="right"), 1, len(times) - 1)
    weight = np.clip((at - times[after - 1]) / (times[after] - times[after - 1]), 0, 1)
    weight = weight.reshape(-1, *[1] * (values.ndim - 1))
    return ((1 - weight) * values[after - 1] + weight * values[after]).astype(np.float32)


def _image_seconds(times: np.ndarray) -> float:
    """Return the mean time for which an image is shown, an assumed one for a single image."""
    return float(times[-1] - times[0]) / (len(times) - 1) if len(times) > 1 else 1 / 25


def _with_images(clips: list[Clip], video: _Video, settings: VideoSettings) -> list[Clip]:
    """Add images of the speaker to the clips: "the first M reference frame images of a clip" (HA2G, Appendix B)."""
    if not settings.num_reference_frames:
        return clips
    skeleton = load_skeleton(SKELETON)
    width, height = images.image_size(video.recording.video)
    wanted: list[tuple[int, images.Box]] = []
    for clip in clips:
        at = clip.recording_start + np.arange(settings.num_reference_frames) / settings.fps
        nearest = np.abs(video.times[:, None] - at).argmin(axis=0)
        box = images.speaker_box(video.poses.image_points[nearest], skeleton, width, height)
        wanted += [(int(number), box) for number in nearest]
    cropped = images.crops(video.recording.video, wanted, settings.image_size)
    of_clips = [
        cropped[i : i + settings.num_reference_frames] for i in range(0, len(cropped), settings.num_reference_frames)
    ]
    return [
        dataclasses.replace(clip, reference_images=np.stack(of_clip))
        for clip, of_clip in zip(clips, of_clips, strict=True)
    ]
