"""Shots are cut where the image changes, counted in images and not in time; no file crashes it."""

import pathlib
import sys
from fractions import Fraction

import av
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ha2g_jax.errors import UserError
from ha2g_jax.importers.video import images
from ha2g_jax.importers.video.extraction import find_shots

MILLISECOND = Fraction(1, 1000)
RED, DARK, WHITE = (200, 30, 30), (20, 30, 20), (230, 230, 230)


def write_colours(path: pathlib.Path, colours, times=None) -> pathlib.Path:
    """A video of images of one colour each."""
    times = np.arange(len(colours)) / 20 if times is None else times
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=20, options={"qscale": "2"})
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        stream.time_base = stream.codec_context.time_base = MILLISECOND
        for colour, time in zip(colours, times, strict=True):
            frame = av.VideoFrame.from_ndarray(np.full((48, 64, 3), colour, np.uint8), format="rgb24")
            frame.pts, frame.time_base = round(time * 1000), MILLISECOND
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def test_a_cut_lies_between_two_images(tmp_path):
    video = write_colours(tmp_path / "cuts.mp4", [RED] * 30 + [DARK] * 25 + [WHITE] * 20)
    assert find_shots(video) == [(0, 30), (30, 55), (55, 75)]


def test_a_video_without_a_cut_is_one_shot(tmp_path):
    video = write_colours(tmp_path / "still.mp4", [RED] * 12)
    assert find_shots(video) == [(0, 12)]


def test_the_threshold_decides_what_is_a_cut(tmp_path):
    video = write_colours(tmp_path / "faint.mp4", [(100, 100, 100)] * 20 + [(130, 130, 130)] * 20)
    assert find_shots(video) == [(0, 40)]
    assert find_shots(video, threshold=5.0) == [(0, 20), (20, 40)]


def test_images_are_counted_where_the_frame_rate_varies(tmp_path):
    # The first 30 images take 6 s, the other 30 take 1 s: by time the cut would be at frame 51 of 60.
    times = np.concatenate([np.arange(30) / 5, 6 + np.arange(30) / 30])
    video = write_colours(tmp_path / "varying.mp4", [RED] * 30 + [DARK] * 30, times)
    assert len(images.image_times(video)) == 60
    assert find_shots(video) == [(0, 30), (30, 60)]


def test_the_real_video_is_cut_where_the_camera_changes(private_data):
    assert find_shots(private_data / "video" / "sample.mp4") == [(0, 348), (348, 509), (509, 518)]


def test_files_that_are_no_videos_are_refused(tmp_path, make_video):
    (tmp_path / "empty.mp4").touch()
    whole = make_video(tmp_path / "whole.mp4").read_bytes()
    (tmp_path / "truncated.mp4").write_bytes(whole[: len(whole) // 2])
    with av.open(str(tmp_path / "sound.mp4"), "w") as container:
        sound = container.add_stream("aac", rate=16000, layout="mono")
        part = av.AudioFrame.from_ndarray(np.zeros((1, 4096), np.float32), format="fltp", layout="mono")
        part.sample_rate = 16000
        container.mux([*sound.encode(part), *sound.encode()])
    for name in ("empty.mp4", "truncated.mp4", "sound.mp4", "absent.mp4"):
        with pytest.raises(UserError, match=name) as caught:
            find_shots(tmp_path / name)
        assert "\n" not in str(caught.value)


def test_what_to_install_is_said(tmp_path, make_video, monkeypatch):
    monkeypatch.setitem(sys.modules, "scenedetect", None)
    with pytest.raises(UserError, match=r"pip install 'ha2g-jax\[import\]'"):
        find_shots(make_video(tmp_path / "any.mp4", seconds=1.0))


@settings(max_examples=30, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(changes=st.lists(st.tuples(st.floats(0, 1), st.integers(0, 255)), max_size=20), end=st.floats(0.02, 1))
def test_damaged_videos_give_shots_or_an_error(tmp_path, make_video, changes, end):
    original = tmp_path / "original.mp4"
    if not original.exists():
        make_video(original, seconds=1.0)
    damaged = bytearray(original.read_bytes())
    damaged = damaged[: round(end * len(damaged))]
    for place, value in changes:
        damaged[int(place * (len(damaged) - 1))] = value
    path = tmp_path / "damaged.mp4"
    path.write_bytes(damaged)
    try:
        shots = find_shots(path)
    except UserError as error:
        assert "damaged.mp4" in str(error)
    else:
        assert shots[0][0] == 0
        assert all(start < stop for start, stop in shots)
