"""When images are shown, and what is cut out of them."""

from fractions import Fraction

import av
import numpy as np
import pytest
from fixtures.videos import HEIGHT, WIDTH, make_video
from PIL import Image

from ha2g_jax.errors import UserError
from ha2g_jax.importers.video import images
from ha2g_jax.importers.video.images import Box
from ha2g_jax.skeleton import load_skeleton

SKELETON = load_skeleton("ted_expressive")


def test_times_are_those_of_the_file(tmp_path):
    """Protects videos of a phone, whose rate varies: words and poses would drift apart if images were counted."""
    stated = np.cumsum(np.r_[0, np.tile([0.1, 0.1, 0.05, 0.2], 10)])
    times = images.image_times(make_video(tmp_path / "uneven.mp4", times=stated))
    np.testing.assert_allclose(times, stated, atol=0.002)
    assert (np.diff(times) > 0).all()


def test_times_start_with_the_sound(tmp_path):
    """Protects the clock of the words: images that begin late are shown late."""
    times = images.image_times(make_video(tmp_path / "late.mkv", times=0.5 + np.arange(20) / 10))
    np.testing.assert_allclose(times, 0.5 + np.arange(20) / 10, atol=0.03)


def test_the_box_holds_head_shoulders_and_hands_and_no_more():
    points = np.full((2, 43, 2), np.nan, np.float32)
    points[0, SKELETON.joint("nose")] = 300, 100
    points[1, SKELETON.joint("left_wrist")] = 380, 260
    points[0, SKELETON.joint("left_elbow")] = 5, 5  # no part of what must be seen
    left, top, side = images.speaker_box(points, SKELETON, 640, 360)
    assert 0 <= left < 300 and left + side > 380 and 0 <= top < 100 and 260 < top + side <= 360
    assert 160 < side < 240


def test_without_points_the_box_is_the_middle():
    assert images.speaker_box(np.full((2, 43, 2), np.nan), SKELETON, 640, 360) == Box(140, 0, 360)


def test_a_box_greater_than_the_image_is_centred_on_it():
    points = np.zeros((1, 43, 2), np.float32)
    points[0, :, 0] = np.linspace(0, 640, 43)
    left, top, side = images.speaker_box(points, SKELETON, 640, 360)
    assert (left, top) == ((640 - side) // 2, (360 - side) // 2) and side > 640


def test_crops_are_of_the_frames_asked_for(tmp_path):
    """Protects the pairing of image and clip: any order, one frame twice, black beyond the edges."""
    video = make_video(tmp_path / "a.mp4", seconds=4)
    crops = images.crops(video, [(30, Box(0, 0, 48)), (7, Box(8, 8, 32)), (30, Box(-48, 0, 48))], 32)
    assert [image.shape for image in crops] == [(32, 32, 3)] * 3 and crops[0].dtype == np.uint8
    assert abs(float(crops[0][..., 1].mean()) - 40) < 3 and abs(float(crops[1][..., 1].mean()) - 17) < 3
    assert crops[2].max() == 0
    assert all((a == b).all() for a, b in zip(crops[:1], images.crops(video, [(30, Box(0, 0, 48))], 32), strict=True))
    with pytest.raises(UserError, match=r"a\.mp4 has no image 40"):
        images.crops(video, [(40, Box(0, 0, 48))], 32)


def test_images_stand_upright(tmp_path):
    """Protects videos of a phone held upright: their images are stored lying, with a rotation beside them."""
    lying = av.VideoFrame.from_ndarray(np.zeros((48, 64, 3), np.uint8), format="rgb24")
    assert images.upright(lying, 1.0).size == (64, 48)
    image = Image.new("RGB", (64, 48))
    image.putpixel((63, 0), (255, 255, 255))

    class Rotated:
        rotation = 90

        def to_ndarray(self, format: str) -> np.ndarray:
            assert format == "rgb24"
            return np.asarray(image)

    shown = images.upright(Rotated(), 1.0)
    assert shown.size == (48, 64) and shown.getpixel((0, 0)) == (255, 255, 255)  # rotated counterclockwise


def test_pixels_that_are_not_square_are_stretched(tmp_path):
    """Protects the widths of hands in HDV and DV, whose images are stored narrower than they are shown."""
    assert images.image_size(make_video(tmp_path / "hdv.mp4", pixels=Fraction(4, 3))) == (round(WIDTH * 4 / 3), HEIGHT)
    assert images.image_size(make_video(tmp_path / "damaged.mp4", pixels=Fraction(99, 1))) == (WIDTH, HEIGHT)


def test_a_small_track_before_the_video_is_not_the_video(tmp_path):
    with av.open(str(tmp_path / "two.mkv"), "w") as container:
        picture = container.add_stream("mjpeg", rate=10, width=16, height=16, pix_fmt="yuvj420p")
        video = container.add_stream("libx264", rate=10, width=64, height=64, pix_fmt="yuv420p")
        for track, layout, count in ((picture, "yuvj420p", 1), (video, "yuv420p", 9)):
            for _ in range(count):
                container.mux(track.encode(av.VideoFrame(track.width, track.height, layout)))
            container.mux(track.encode())
    assert len(images.image_times(tmp_path / "two.mkv")) == 9
    assert images.image_size(tmp_path / "two.mkv") == (64, 64)


def test_a_file_that_was_cut_off_is_named(tmp_path):
    """Protects from half a download: with the index in front, what is there can be read, and words would be missed."""
    whole = make_video(tmp_path / "whole.mp4", movflags="faststart")
    assert len(images.image_times(whole)) == 60
    half = tmp_path / "half.mp4"
    half.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    with pytest.raises(UserError, match=r"half\.mp4 was cut off: it has \d\.\d s of images but declares more"):
        images.image_times(half)
