"""Shots are cut where the image changes; those that fulfil the three conditions of the paper become clips."""

import shutil

import numpy as np
import pytest
from fixtures.videos import make_recording, make_video, pose_command

from ha2g_jax.data import records
from ha2g_jax.errors import UserError
from ha2g_jax.importers.video import extraction, images
from ha2g_jax.importers.video.extraction import VideoRecording, find_shots, is_still, is_visible
from ha2g_jax.importers.video.settings import VideoSettings
from ha2g_jax.skeleton import load_skeleton

SKELETON = load_skeleton("ted_expressive")


@pytest.fixture
def extract(tmp_path):
    def run(video, kind="wave", **settings):
        settings = VideoSettings(pose_command=pose_command(tmp_path / "calls", kind), **settings)
        return extraction.extract(VideoRecording(video, "folder/talk", "ada"), settings)

    return run


def test_a_video_becomes_a_clip(extract, tmp_path):
    """Protects the whole import: rate, words, sound, confidence, images, and the counts of the report."""
    extracted = extract(make_recording(tmp_path / "talk.mp4"))
    assert not extracted.report.rejected
    [record] = extracted.records
    clip = records.decode_clip(record)
    assert (clip.id, clip.recording, clip.speaker, clip.recording_start) == ("folder/talk-0", "folder/talk", "ada", 0.0)
    assert len(clip.positions) == 89  # 59 steps of 0.1 s at 15 frames per second, and the first
    assert abs(len(clip.audio) / 16000 - 89 / 15) < 0.001 and np.abs(clip.audio).max() > 0.2
    assert [word.text for word in clip.words] == [f"word{number}" for number in range(11)]
    assert clip.words[3] == ("word3", pytest.approx(1.6), pytest.approx(1.9))
    assert clip.confidence is not None and clip.confidence[0, 20] == 0 and clip.confidence[40].min() == 1
    assert clip.positions.shape == (89, 43, 3) and np.isfinite(clip.positions).all() and clip.window_starts
    assert clip.reference_images is not None and clip.reference_images.shape == (7, 224, 224, 3)
    assert (extracted.frames, extracted.frames_with_both_hands, extracted.shots) == (60, 45, 1)
    assert extracted.seconds == pytest.approx(6, abs=0.01)
    assert (extracted.report.videos, extracted.report.clips, extracted.report.kept) == (1, 1, len(clip.window_starts))


def test_the_place_of_a_video_leaves_no_trace(extract, tmp_path):
    """Protects equal bytes on every machine, and the privacy of whoever's folders those are."""
    video = make_recording(tmp_path / "here" / "talk.mp4")
    shutil.copytree(video.parent, tmp_path / "there")
    here, there = extract(video), extract(tmp_path / "there" / "talk.mp4")
    assert here == there and here.records
    assert all(str(tmp_path).encode() not in record for record in here.records)


@pytest.mark.parametrize(
    ("kind", "seconds", "reason"),
    [("still", 6, "still"), ("unseen", 6, "keypoints unseen"), ("wave", 5, "shot too short")],
)
def test_each_condition_rejects_and_is_counted(extract, tmp_path, kind, seconds, reason):
    extracted = extract(make_recording(tmp_path / "talk.mp4", seconds=seconds), kind)
    assert extracted.records == [] and extracted.report.rejected == {reason: 1} and extracted.report.clips == 0


def test_images_before_the_sound_are_left_out(extract, tmp_path):
    """Protects the pairing of speech and motion where the camera was on before the microphone."""
    video = make_recording(tmp_path / "talk.mkv", seconds=9, sound_start=2.0)
    clip = records.decode_clip(extract(video).records[0])
    assert 0 <= clip.recording_start < 0.1 and len(clip.positions) / 15 == pytest.approx(7, abs=0.2)


def test_a_time_far_off_makes_no_endless_clip(extract, tmp_path):
    """Protects the memory from a file that states a image an hour later."""
    times = np.r_[np.arange(60) / 10, 3000.0]
    clip = records.decode_clip(extract(make_recording(tmp_path / "talk.mkv", times=times)).records[0])
    assert len(clip.positions) / 15 == pytest.approx(6, abs=0.2)


def test_a_hole_in_the_images_is_not_filled(extract, tmp_path):
    """Protects from motion that nobody made: a recorded call has no images for seconds."""
    times = np.r_[np.arange(80) / 10, 10 + np.arange(60) / 10]
    extracted = extract(make_recording(tmp_path / "talk.mkv", seconds=16, times=times), max_gap=0.0)
    clips = [records.decode_clip(record) for record in extracted.records]
    assert [round(clip.recording_start) for clip in clips] == [0, 10]
    assert [len(clip.positions) / 15 for clip in clips] == pytest.approx([8, 6], abs=0.2)


def test_a_clip_shows_its_own_first_images(extract, tmp_path):
    """Protects the pairing of clips and images: two clips of one shot have different ones."""
    extracted = extract(make_recording(tmp_path / "talk.mp4", seconds=12), max_seconds=9.0, num_reference_frames=2)
    first, second = (records.decode_clip(record) for record in extracted.records)
    assert second.id == "folder/talk-1" and first.reference_images is not None and second.reference_images is not None
    shown = 10 + second.recording_start * 10  # green rises by one each image
    assert abs(float(second.reference_images[0][..., 1].mean()) - shown) < 3
    assert abs(float(first.reference_images[0][..., 1].mean()) - 10) < 3 and shown > 40


def test_resampling_is_linear_at_any_spacing():
    times = np.array([0.0, 0.1, 0.35, 0.4, 1.0])
    values = np.stack([3 * times, 1 - times], axis=-1)[:, None]
    at = np.array([0.0, 0.05, 0.2, 0.4, 0.99, 1.0])
    np.testing.assert_allclose(extraction.resample(values, times, at)[:, 0].T, [3 * at, 1 - at], atol=1e-6)


def test_poses_of_other_images_are_refused(extract, tmp_path):
    """Protects an estimator of one's own that skips images: everything after would be shifted."""
    with pytest.raises(UserError, match=r"talk\.mp4 has 60 images.* 59 "):
        extract(make_recording(tmp_path / "talk.mp4"), "short")


@pytest.mark.parametrize(("num_seen", "is_expected"), [(50, False), (51, True), (0, False)])
def test_all_keypoints_are_seen_in_more_than_half_of_the_frames(num_seen, is_expected):
    confidence = np.ones((100, 43), np.float32)
    confidence[num_seen:, 17] = 0.3  # one finger joint is enough
    assert is_visible(confidence, 0.5, VideoSettings().min_visible) is is_expected


def test_keypoints_are_to_be_seen_at_once():
    """Protects the reading of condition 1: each hand seen in 60 %, but never both, is not the 43 keypoints."""
    confidence = np.ones((100, 43), np.float32)
    confidence[:60, 20], confidence[40:, 30] = 0, 0
    assert not is_visible(confidence, 0.5, 0.5)
    assert not is_visible(np.zeros((10, 43)), 0.0, 0.5)  # what was not found is not seen, whatever the threshold


@pytest.mark.parametrize(("wrist", "amplitude", "is_expected"), [(6, 0.06, False), (7, 0.06, False), (7, 0.04, True)])
def test_one_moving_wrist_is_motion(wrist, amplitude, is_expected):
    """A sine of amplitude a has variance a^2 / 2: 0.0018 and 0.0008 around the threshold of 0.0014."""
    positions = np.tile(SKELETON.mean_pose, (200, 1, 1))
    positions[:, wrist, 1] += amplitude * np.sin(np.linspace(0, 10 * np.pi, 200))
    positions[:, SKELETON.joint("nose")] += np.linspace(0, 1, 200)[:, None]  # the head alone makes no gesture
    assert is_still(positions, SKELETON, VideoSettings().min_motion) is is_expected


RED, DARK, WHITE = (200, 30, 30), (20, 30, 20), (230, 230, 230)


def test_a_cut_lies_between_two_images(tmp_path):
    video = make_video(tmp_path / "cuts.mp4", colours=[RED] * 30 + [DARK] * 25 + [WHITE] * 20)
    assert find_shots(video) == [(0, 30), (30, 55), (55, 75)]


def test_the_threshold_decides_what_is_a_cut(tmp_path):
    video = make_video(tmp_path / "faint.mp4", colours=[(100, 100, 100)] * 20 + [(130, 130, 130)] * 20)
    assert find_shots(video) == [(0, 40)]
    assert find_shots(video, threshold=5.0) == [(0, 20), (20, 40)]


def test_images_are_counted_where_the_frame_rate_varies(tmp_path):
    # The first 30 images take 6 s, the other 30 take 1 s: by time the cut would be at frame 51 of 60.
    times = np.concatenate([np.arange(30) / 5, 6 + np.arange(30) / 30])
    video = make_video(tmp_path / "varying.mp4", colours=[RED] * 30 + [DARK] * 30, times=times)
    assert len(images.image_times(video)) == 60
    assert find_shots(video) == [(0, 30), (30, 60)]


def test_the_real_video_is_cut_where_the_camera_changes(private_data):
    assert find_shots(private_data / "video" / "sample.mp4") == [(0, 348), (348, 509), (509, 518)]
