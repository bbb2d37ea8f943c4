"""The video plays in step with the sound, on any player, and is the same twice."""

import av
import numpy as np
import pytest

from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.video import write_video
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
        return np.stack([frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)])


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
    assert len(heard) / 16000 == pytest.approx(seconds, abs=0.1)
    assert np.abs(heard).max() == pytest.approx(0.3, abs=0.05)


def test_the_same_video_twice_and_nothing_else_in_the_folder(tmp_path, motion):
    for name in ("a.mp4", "b.mp4"):
        write_video(tmp_path / name, motion, tone(1), size=64, has_progress=False)
    assert (tmp_path / "a.mp4").read_bytes() == (tmp_path / "b.mp4").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.mp4", "b.mp4"]


def test_the_index_comes_first_so_that_it_plays_while_it_loads(tmp_path, motion):
    write_video(tmp_path / "v.mp4", motion, tone(0.5), size=64, has_progress=False)
    content = (tmp_path / "v.mp4").read_bytes()
    assert content.index(b"moov") < content.index(b"mdat")


def test_an_interrupted_video_leaves_nothing(tmp_path, motion, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("ha2g_jax.motion.video.draw_figure", interrupt)
    with pytest.raises(KeyboardInterrupt):
        write_video(tmp_path / "v.mp4", motion, tone(1), size=64, has_progress=False)
    assert list(tmp_path.iterdir()) == []


def test_motions_by_name_are_drawn_side_by_side_with_their_names(tmp_path, motion):
    still = Motion.from_directions(motion.skeleton, motion.directions[:1], 15)
    write_video(tmp_path / "v.mp4", {"left": motion, "right": still}, tone(1), size=64, has_progress=False)
    write_video(tmp_path / "l.mp4", motion, tone(1), size=64, has_progress=False)
    both, left = (pictures(tmp_path / name).astype(int) for name in ("v.mp4", "l.mp4"))
    assert both.shape == (30, 64, 128, 3)
    bodies = slice(16, None)  # names are above
    moved = np.abs(both[-1] - both[0])[bodies].mean(axis=(0, 2))
    assert moved[64:].mean() < 1 < moved[:64].mean()
    np.testing.assert_allclose(both[:, bodies, :64].mean(), left[:, bodies].mean(), atol=1)
    assert np.abs(both[0, :16, :64] - left[0, :16]).max() > 50
