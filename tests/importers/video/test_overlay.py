"""The overlay is the video with bones on it where they are seen, its sound, and its timing."""

import pathlib

import av
import numpy as np
import pytest
from fixtures.videos import HEIGHT, WIDTH, make_video

from ha2g_jax.importers.video.images import image_times
from ha2g_jax.importers.video.overlay import write_overlay
from ha2g_jax.skeleton import load_skeleton

SKELETON = load_skeleton("ted_expressive")


def points_of(count: int) -> np.ndarray:
    """A speaker in the middle of the image."""
    pose = SKELETON.mean_pose - SKELETON.mean_pose[SKELETON.joint("neck")]
    return np.tile(np.array([32, 20]) + 50 * pose[:, :2], (count, 1, 1)).astype(np.float32)


def read(path: pathlib.Path) -> tuple[list[float], np.ndarray]:
    with av.open(str(path)) as container:
        frames = list(container.decode(video=0))
    return [frame.time for frame in frames], np.stack([frame.to_ndarray(format="rgb24") for frame in frames])


def sound_seconds(path: pathlib.Path) -> float:
    with av.open(str(path)) as container:
        return sum(frame.samples / frame.sample_rate for frame in container.decode(audio=0))


def test_bones_are_drawn_where_they_are_seen(tmp_path):
    video = make_video(tmp_path / "video.mp4", seconds=2.0)
    points, confidence = points_of(20), np.ones((20, 43), np.float32)
    hand = [number for number, name in enumerate(SKELETON.joints) if "left" in name and number > 2]
    confidence[10:, hand] = 0
    points[10:, hand] = np.nan
    confidence[15:] = 0
    write_overlay(tmp_path / "out.mp4", video, image_times(video), points, confidence)
    before, after = read(video)[1].astype(int), read(tmp_path / "out.mp4")[1].astype(int)
    assert after.shape == (20, HEIGHT, WIDTH, 3)
    change = np.abs(after - before).max(axis=-1)
    assert change[15:].max() < 12
    x, y = points[0, SKELETON.joint("left_elbow")].astype(int)
    at_elbow = change[:, y - 2 : y + 2, x - 1 : x + 2].max(axis=(1, 2))
    assert at_elbow[:10].min() > 60
    assert at_elbow[10:].max() < 30
    left, right = (after[5, int(y), int(x)] for x, y in (points[0, 2:4].round() - [[3, 0], [-3, 0]]))
    assert left[0] > left[2]  # orange
    assert right[0] < right[2]  # blue


def test_sound_and_times_stay(tmp_path):
    times = np.concatenate([np.arange(10) / 10, 1.5 + np.arange(10) / 20])
    video = make_video(tmp_path / "video.mp4", seconds=3.0, times=times)
    write_overlay(tmp_path / "out.mp4", video, image_times(video), points_of(20), np.ones((20, 43)))
    np.testing.assert_allclose(read(tmp_path / "out.mp4")[0], times, atol=0.002)
    assert sound_seconds(tmp_path / "out.mp4") == pytest.approx(sound_seconds(video), abs=0.15)


def test_images_before_the_sound_stay_before_it(tmp_path):
    video = make_video(tmp_path / "video.mp4", seconds=2.0, sound_start=0.5)
    write_overlay(tmp_path / "out.mp4", video, image_times(video), points_of(20), np.ones((20, 43)))
    with av.open(str(tmp_path / "out.mp4")) as container:
        assert next(container.decode(audio=0)).time == pytest.approx(0.5, abs=0.15)  # AAC begins with a little silence
    assert read(tmp_path / "out.mp4")[0][0] == pytest.approx(0, abs=0.002)


def test_a_video_without_sound_has_none_afterwards(tmp_path):
    video = make_video(tmp_path / "video.mp4", seconds=1.0, with_sound=False)
    write_overlay(tmp_path / "out.mp4", video, image_times(video), points_of(10), np.ones((10, 43)))
    with av.open(str(tmp_path / "out.mp4")) as container:
        assert not container.streams.audio
        assert len(container.streams.video) == 1


def test_points_far_away_and_odd_values_are_drawn_or_not_but_never_crash(tmp_path):
    video = make_video(tmp_path / "video.mp4", seconds=1.0)
    points = points_of(10)
    points[:5] *= 1e7
    points[5, 0], points[6, 1] = np.inf, np.nan
    write_overlay(tmp_path / "out.mp4", video, image_times(video), points, np.ones((10, 43)))
    assert len(read(tmp_path / "out.mp4")[0]) == 10
