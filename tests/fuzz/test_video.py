"""The images of any video are read or refused in one line, and copied with a skeleton or refused."""

import pathlib
import struct

import numpy as np
import pytest
from fuzz import recordings
from fuzz.mutation import FUZZ, damaged_bytes
from hypothesis import given
from hypothesis import strategies as st

from ha2g_jax.errors import UserError
from ha2g_jax.importers.video import extraction, images, overlay

VIDEOS = {f"{kind[2]}.{kind[0]}": kind for kind in recordings.VIDEO_KINDS}


def read(path: pathlib.Path) -> None:
    images.image_times(path)
    images.image_size(path)
    images.crops(path, [(0, images.Box(0, 0, 8)), (3, images.Box(-5, 9, 80))], 8)
    extraction.find_shots(path)


def copy(path: pathlib.Path) -> None:
    count = len(images.image_times(path))
    points = np.random.default_rng(0).uniform(0, recordings.SIDE, (count, 43, 2))
    overlay.write_overlay(path.with_suffix(".copy.mp4"), path, points, np.ones((count, 43)))


@pytest.mark.parametrize("name", VIDEOS)
def test_the_videos_to_damage_are_read(tmp_path, name):
    (tmp_path / name).write_bytes(recordings.ffmpeg_bytes(*VIDEOS[name]))
    read(tmp_path / name)
    copy(tmp_path / name)


@FUZZ
@given(data=st.data(), name=st.sampled_from(sorted(VIDEOS)))
def test_a_damaged_video(answered, data, name):
    answered(read, data.draw(damaged_bytes(recordings.ffmpeg_bytes(*VIDEOS[name]))), name)


@FUZZ
@given(data=st.data(), name=st.sampled_from(sorted(VIDEOS)))
def test_a_copy_of_a_damaged_video(answered, data, name):
    content = recordings.ffmpeg_bytes(*VIDEOS[name])
    answered(copy, data.draw(damaged_bytes(content[:400])) + content[400:], name)


@pytest.mark.parametrize(
    ("limit", "value", "message"),
    [
        ("MAX_VIDEO_PIXELS", 1_000, "has images of 64 x 64 and 6144 bytes; expected at most"),
        ("MAX_VIDEO_IMAGE_BYTES", 1_000, "has images of 64 x 64 and 6144 bytes; expected at most"),
        ("MAX_VIDEO_IMAGES", 5, "more than 5 images"),
    ],
)
def test_images_beyond_the_limits_are_refused(tmp_path, monkeypatch, limit, value, message):
    monkeypatch.setattr(f"ha2g_jax.importers.video.images.{limit}", value)
    (tmp_path / "large.mp4").write_bytes(recordings.ffmpeg_bytes("mp4", "aac", "libx264"))
    with pytest.raises(UserError, match=message):
        images.image_times(tmp_path / "large.mp4")


@pytest.mark.parametrize("side", [8_192, 30_000, 2**31 - 1])
def test_a_size_in_a_header_takes_no_memory(answered, side):
    content = recordings.ffmpeg_bytes("avi", "pcm_s16le", "mpeg4")
    size = struct.pack("<2i", recordings.SIDE, recordings.SIDE)
    assert size in content
    answered(read, content.replace(size, struct.pack("<2i", side, side)), "large.avi")
