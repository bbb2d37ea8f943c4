"""Extraction of the clips of one video (HA2G, Appendix A): shots, poses, three conditions, words and images."""

import dataclasses
import itertools
import pathlib
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ha2g_jax.data.recording import Recording, SplitReport, seen, to_clips
from ha2g_jax.data.records import Clip, encode_clip
from ha2g_jax.errors import UserError, require
from ha2g_jax.features import words as transcripts
from ha2g_jax.features.audio import SAMPLE_RATE, read_audio
from ha2g_jax.features.text import Word
from ha2g_jax.files.reading import shown
from ha2g_jax.importers.video import images, keypoints, overlay, pose
from ha2g_jax.importers.video.images import decode, no_images, open_video
from ha2g_jax.importers.video.keypoints import Keypoints
from ha2g_jax.importers.video.settings import VideoSettings
from ha2g_jax.skeleton import Skeleton, hand_joints, load_skeleton

SKELETON = "ted_expressive"
# Version of the results of `extract`; a new number makes a continued build read its videos again.
VERSION = 3

_WIDTH = 256  # pixels, for speed; about the size to which PySceneDetect reduces images, for which its thresholds hold
_LONGEST_IMAGE = 0.5  # seconds to the next image above which a shot ends
_FLASH_SECONDS = 0.5  # cuts that are closer in time count as one


class VideoRecording(NamedTuple):
    """A video of a speaker.

    Attributes:
        video: absolute path of the video.
        name: path within the common folder of all videos, without suffix unless another video has the same path.
        speaker: first subfolder of the common folder, or `name` if the video lies directly in the common folder.
        is_alone: whether no other video is in its folder.
    """

    video: pathlib.Path
    name: str
    speaker: str
    is_alone: bool = True

    @property
    def transcript(self) -> pathlib.Path | None:
        """The transcript beside the video, None if there is none."""
        return transcripts.find(self.video, is_alone=self.is_alone)


class Extraction(NamedTuple):
    """The clips of one video, encoded, in order of time, and its numbers of images, seconds and shots."""

    records: list[bytes]
    report: SplitReport
    frames: int
    frames_with_both_hands: int  # in which wrists and fingers of both hands are seen
    seconds: float
    shots: int


class _Video(NamedTuple):
    """Contents of a video; times in seconds from the start of its audio."""

    recording: VideoRecording
    audio: np.ndarray
    words: tuple[Word, ...]
    times: np.ndarray
    poses: Keypoints


def extract(
    recording: VideoRecording,
    settings: VideoSettings,
    *,
    overlay_path: pathlib.Path | None = None,
) -> Extraction:
    """Extract the clips of one video; equal videos and settings give equal bytes on any machine.

    The video must have a transcript beside it unless `settings.recognise` is set. `overlay_path` is that of a copy of
    the video with the skeleton drawn on the speaker; None for no copy.

    Raises:
        UserError: the audio, the images, the words or the poses cannot be obtained.
    """
    # First the steps that are fast and may fail.
    video = recording.video
    audio = read_audio(video)
    times = images.image_times(video)
    words = transcripts.words_of(
        audio, recording.transcript, recognise=settings.recognise, media=video, speaker=recording.speaker
    )
    spans = without_gaps(find_shots(video, settings.shot_threshold), times, _LONGEST_IMAGE)
    poses = pose.estimate(video, command=settings.pose_command)
    if len(poses.positions) != len(times):
        raise UserError(
            f"{shown(video)} has {len(times)} images, but the pose estimator returned {len(poses.positions)} poses; "
            "expected one for each image, in order"
        )
    if overlay_path is not None:
        overlay.write_overlay(overlay_path, video, times, poses.image_points, poses.confidence)

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
    hands = poses.confidence[:, hand_joints(load_skeleton(SKELETON))]
    return Extraction(
        records=[encode_clip(clip) for clip in _with_images(clips, content, settings)],
        report=dataclasses.replace(report, videos=1),
        frames=len(times),
        frames_with_both_hands=int(seen(hands, settings.min_confidence).sum()),
        seconds=round(float(times[-1] - times[0]) + _image_seconds(times), 3),
        shots=len(spans),
    )


def _read_shot(video: _Video, start: int, end: int, settings: VideoSettings) -> tuple[Recording | None, str]:
    """Return the recording of images [start, end), or None and the condition that the shot does not fulfil."""
    # Images before and after the audio have no speech, and a wrong time in a damaged file must not give many frames.
    with_sound = np.searchsorted(video.times, [0, len(video.audio) / SAMPLE_RATE])
    start, end = max(start, int(with_sound[0])), min(end, int(with_sound[1]))
    times, confidence = video.times[start:end], video.poses.confidence[start:end]
    fps = 1 / _image_seconds(times)
    if len(times) < 2 or len(times) / fps <= settings.min_seconds:  # condition 3
        return None, "shot too short"
    if not is_visible(confidence, settings.min_confidence, settings.min_visible):
        return None, "keypoints unseen"
    positions = keypoints.clean(
        video.poses.positions[start:end], confidence, fps, max_gap=settings.max_gap, cutoff=settings.cutoff
    )
    at = times[0] + np.arange(int((times[-1] - times[0]) * settings.fps + 1e-6) + 1) / settings.fps
    positions, confidence = resample(positions, times, at), resample(confidence, times, at)
    if is_still(positions, load_skeleton(SKELETON), settings.min_motion):
        return None, "still"
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
    """Interpolate values (T, ...) of ascending times (T,) linearly at other times (N,); returns (N, ...) float32."""
    after = np.clip(np.searchsorted(times, at, side="right"), 1, len(times) - 1)
    weight = np.clip((at - times[after - 1]) / (times[after] - times[after - 1]), 0, 1)
    weight = weight.reshape(-1, *[1] * (values.ndim - 1))
    return ((1 - weight) * values[after - 1] + weight * values[after]).astype(np.float32)


def _image_seconds(times: np.ndarray) -> float:
    """Return the mean time for which an image is shown, an assumed one for a single image."""
    return float(times[-1] - times[0]) / (len(times) - 1) if len(times) > 1 else 1 / images.DEFAULT_RATE


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


def scene_detector() -> Any:
    """Return the package that detects shots; a `UserError` says that it is not installed."""
    return require("scenedetect", "import", by="the import of videos", package="scenedetect-headless")


def find_shots(video: pathlib.Path, threshold: float = VideoSettings.shot_threshold) -> list[tuple[int, int]]:
    """Return [first image, end image) of each shot of a video, in order, by PySceneDetect's content detector.

    Images are counted as they are decoded and passed to the detector by number, as the frame rate may vary. The
    threshold is the mean change of hue, saturation and brightness (each of 255) between two images that makes a cut.

    Raises:
        UserError: the file has no readable images, or PySceneDetect is not installed.
    """
    scenedetect = scene_detector()
    detector = scenedetect.ContentDetector(threshold=threshold, min_scene_len=_FLASH_SECONDS)
    borders, num_frames = [0], 0
    with open_video(video) as container:
        rate = images.image_rate(container)
        for frame in decode(video, container):
            width = min(_WIDTH, frame.width)
            height = max(1, round(frame.height * width / frame.width))
            image = frame.to_ndarray(format="bgr24", width=width, height=height)
            cuts = detector.process_frame(scenedetect.FrameTimecode(num_frames, rate), image)
            borders += [cut.frame_num for cut in cuts]
            num_frames += 1
    if not num_frames:
        raise no_images(video)
    return list(itertools.pairwise(sorted({*borders, num_frames})))


def without_gaps(shots: Sequence[tuple[int, int]], times: np.ndarray, max_gap: float) -> list[tuple[int, int]]:
    """Divide shots where two images (T,) are more than `max_gap` seconds apart, as where a call dropped images."""
    gaps = {int(index) + 1 for index in np.flatnonzero(np.diff(times) > max_gap)}
    borders = [sorted({start, end, *(gap for gap in gaps if start < gap < end)}) for start, end in shots]
    return [span for of_shot in borders for span in itertools.pairwise(of_shot)]


def is_visible(confidence: np.ndarray, min_confidence: float, min_visible: float) -> bool:
    """Return whether more than a fraction `min_visible` of the images show all keypoints, see `seen` (condition 1)."""
    return bool(seen(confidence, min_confidence).mean() > min_visible)


def is_still(positions: np.ndarray, skeleton: Skeleton, min_motion: float) -> bool:
    """Return whether both wrists of positions (T, joints, 3) in metres hardly move (condition 2).

    A moving wrist has at least `min_motion` square metres of variance, summed over x, y and z.
    """
    wrists = positions[:, [skeleton.joint("left_wrist"), skeleton.joint("right_wrist")]].astype(np.float64)
    return bool((wrists.var(axis=0).sum(axis=-1) < min_motion).all())
