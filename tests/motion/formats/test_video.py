"""The video plays in step with the sound, on any player, and is the same twice."""

import av
import numpy as np
import pytest

from ha2g_jax.errors import UserError
from ha2g_jax.figure import DEFAULT_LOOK, DEFAULT_VIEW, SHIRTS, draw_figure
from ha2g_jax.motion.formats.video import write_video
from ha2g_jax.motion.motion import Motion
from ha2g_jax.skeleton import load_skeleton


@pytest.fixture(scope="module")
def motion() -> Motion:
    """A second of the mean pose with the head turning."""
    skeleton = load_skeleton("ted_expressive")
    directions = np.repeat(skeleton.mean_directions[None], 15, axis=0)
    directions[:, skeleton.bone("nose"), 0] += np.linspace(-1, 1, 15)
    return Motion.from_directions(skeleton, directions, 15)


def tone(seconds: float) -> np.ndarray:
    return (0.3 * np.sin(2 * np.pi * 440 * np.arange(round(seconds * 16000)) / 16000)).astype(np.float32)


def pictures(path) -> np.ndarray:
    with av.open(str(path)) as container:
        frames = (frame.reformat(format="rgb24", src_colorspace="ITU709") for frame in container.decode(video=0))
        return np.stack([frame.to_ndarray() for frame in frames])


def test_a_name_may_have_a_colon(tmp_path, motion, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_video("10:15 talk.mp4", motion, None, size=64, has_progress=False)
    assert pictures("file:10:15 talk.mp4").any()


@pytest.mark.parametrize("seconds", [0.2, 1.0, 2.51])
def test_picture_and_sound_last_as_long_as_the_speech(tmp_path, motion, seconds):
    write_video(tmp_path / "v.mp4", motion, tone(seconds), size=64, has_progress=False)
    with av.open(str(tmp_path / "v.mp4")) as container:
        video, sound = container.streams.video[0], container.streams.audio[0]
        assert video.codec_context.name == "h264"
        assert video.codec_context.pix_fmt == "yuv420p"
        assert (video.width, video.height, video.average_rate) == (64, 64, 30)
        assert sound.codec_context.name == "aac"
        assert (container.duration or 0) / av.time_base == pytest.approx(seconds, abs=0.04)
        assert sum(1 for _ in container.decode(video)) == round(seconds * 30)
        container.seek(0)
        heard = np.concatenate([frame.to_ndarray()[0] for frame in container.decode(sound)])
        codec = video.codec_context  # without its colours, players take BT.601 or BT.709 by the size of the picture
        assert (codec.colorspace, codec.color_primaries, codec.color_trc, codec.color_range) == (1, 1, 1, 1)
    content = (tmp_path / "v.mp4").read_bytes()
    assert content.index(b"moov") < content.index(b"mdat")  # so that it plays while it loads
    assert len(heard) / 16000 == pytest.approx(seconds, abs=0.1)
    assert np.abs(heard).max() == pytest.approx(0.3, abs=0.05)


def test_sound_of_integers_is_that_of_floats(tmp_path, motion):
    steps = np.rint(32767 * tone(1)).astype(np.int16)
    for name, sound in (("a.mp4", steps), ("b.mp4", steps / 32768)):
        write_video(tmp_path / name, motion, sound, size=32, has_progress=False)
    assert (tmp_path / "a.mp4").read_bytes() == (tmp_path / "b.mp4").read_bytes()
    with pytest.raises(UserError, match="0 samples per second"):
        write_video(tmp_path / "v.mp4", motion, tone(1), 0)


@pytest.mark.parametrize("fps", [1, 30000 / 1001, 60, 120.5])
def test_a_video_of_another_rate_lasts_as_long(tmp_path, motion, fps):
    write_video(tmp_path / "v.mp4", motion, tone(2), size=32, fps=fps, has_progress=False)
    with av.open(str(tmp_path / "v.mp4")) as container:
        video = container.streams.video[0]
        assert video.average_rate and video.duration and video.time_base
        assert float(video.average_rate) == pytest.approx(fps) and video.frames == round(2 * fps)
        assert float(video.duration * video.time_base) == pytest.approx(2, abs=1 / fps)
    with pytest.raises(UserError, match=r"0\.5 frames per second; give 1 to 240"):
        write_video(tmp_path / "v.mp4", motion, None, fps=0.5)


def test_the_same_bytes_by_any_number_of_workers_and_nothing_else_in_the_folder(tmp_path, motion):
    names = [f"{workers}.mp4" for workers in (1, 2, 5)]
    for name in names:
        write_video(tmp_path / name, motion, tone(9.1), size=64, workers=int(name[0]), has_progress=False)
    assert len({(tmp_path / name).read_bytes() for name in names}) == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["1.mp4", "2.mp4", "5.mp4"]


def test_pictures_are_in_order_over_the_borders_of_pieces(tmp_path, motion):
    """Each piece is encoded on its own; a player sees one video, in which the head turns evenly."""
    turning = slowly(motion, seconds=7)
    write_video(tmp_path / "v.mp4", turning, None, size=64, view=DEFAULT_VIEW, workers=3, has_progress=False)
    with av.open(str(tmp_path / "v.mp4")) as container:
        stream = container.streams.video[0]
        packets = [packet for packet in container.demux(stream) if packet.size]
        assert [packet.pts and float(packet.pts * packet.time_base * 30) for packet in packets] == list(range(210))
        assert [index for index, packet in enumerate(packets) if packet.is_keyframe] == [0, 60, 120, 180]
    seen = pictures(tmp_path / "v.mp4").astype(int)
    poses = turning.positions[::7]
    drawn = np.stack([draw_figure(pose, motion.skeleton, DEFAULT_LOOK, 64, 64) for pose in poses]).astype(int)
    distance = np.abs(drawn[:, None] - seen[None, ::7]).mean(axis=(2, 3, 4))
    assert np.abs(np.argmin(distance, axis=1) - np.arange(30)).max() <= 1
    assert np.ptp(np.argmin(distance, axis=1)) >= 28  # the pictures do differ


def slowly(motion: Motion, seconds: int) -> Motion:
    """The head turns from one side to the other, 30 frames a second."""
    directions = np.repeat(motion.skeleton.mean_directions[None], 30 * seconds, axis=0)
    directions[:, motion.skeleton.bone("nose"), 0] += np.linspace(-1, 1, 30 * seconds)
    return Motion.from_directions(motion.skeleton, directions, 30)


def test_the_video_looks_like_the_drawing(tmp_path, motion):
    """The planes of the video are drawn on a way of their own; colours and places are those of a drawing in RGB."""
    write_video(tmp_path / "v.mp4", motion, None, size=256, view=DEFAULT_VIEW, has_progress=False)
    drawn = draw_figure(motion.positions[0], motion.skeleton, DEFAULT_LOOK, 256, 256).astype(int)
    difference = np.abs(pictures(tmp_path / "v.mp4")[0].astype(int) - drawn)
    assert difference.mean() < 2.5
    assert np.quantile(difference, 0.97) < 14


def test_without_sound_the_video_is_silent_and_as_long_as_the_longest_motion(tmp_path, motion):
    long = slowly(motion, seconds=3)
    write_video(tmp_path / "v.mp4", {"a": motion, "b": long}, None, size=(128, 64), has_progress=False)
    with av.open(str(tmp_path / "v.mp4")) as container:
        assert not container.streams.audio
        assert sum(1 for _ in container.decode(video=0)) == 90


@pytest.mark.parametrize("size", [(65, 64), (64, 0), (8192, 64), (-64, 64)])
def test_a_size_that_no_player_takes_is_refused(tmp_path, motion, size):
    with pytest.raises(UserError, match=r"even sides of 32 to 4096"):
        write_video(tmp_path / "v.mp4", motion, None, size=size, has_progress=False)
    assert list(tmp_path.iterdir()) == []


def test_motions_by_name_are_drawn_side_by_side_with_their_names(tmp_path, motion):
    still = Motion.from_directions(motion.skeleton, motion.directions[:1], 15)
    write_video(tmp_path / "v.mp4", {"left": motion, "right": still}, tone(1), size=128, has_progress=False)
    write_video(tmp_path / "l.mp4", motion, tone(1), size=128, has_progress=False)
    both, left = (pictures(tmp_path / name).astype(int) for name in ("v.mp4", "l.mp4"))
    assert both.shape == (30, 128, 256, 3)
    bodies = slice(32, None)  # names are above
    moved = np.abs(both[-1] - both[10])[bodies].mean(axis=(0, 2))
    assert moved[128:].mean() < 1
    assert moved[:128].mean() > 2
    for place, shirt in zip((slice(0, 128), slice(128, None)), SHIRTS, strict=False):
        assert (np.abs(both[:, bodies, place] - shirt).sum(axis=-1) < 60).mean() > 0.1
    assert np.abs(both[0, :16, :128] - left[0, :16]).max() > 50
