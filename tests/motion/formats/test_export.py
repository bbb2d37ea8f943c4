"""One function writes every format; what cannot be written is an error of one line and leaves no file."""

import numpy as np
import pytest

from ha2g_jax.errors import UserError
from ha2g_jax.motion import formats
from ha2g_jax.motion.motion import Motion
from ha2g_jax.skeleton import load_skeleton, normalize


def make(name: str = "ted_expressive", frames: int = 9) -> Motion:
    skeleton = load_skeleton(name)
    random = np.random.default_rng(0).normal(0, 0.1, (frames, skeleton.num_bones, 3))
    directions = normalize(skeleton.mean_directions + random.cumsum(axis=0) / 5)
    return Motion.from_directions(skeleton, directions, 15, {"speech": "a.wav", "duration": 0.61})


@pytest.mark.parametrize("name", ["ted_expressive", "ted_gesture"])
@pytest.mark.parametrize("suffix", formats.SUFFIXES)
def test_every_format_is_written_with_the_same_bytes_twice(tmp_path, name, suffix):
    for stem in ("a", "b"):
        formats.export(make(name), tmp_path / f"{stem}{suffix}")
    first = (tmp_path / f"a{suffix}").read_bytes()
    assert len(first) > 1000
    assert first == (tmp_path / f"b{suffix}").read_bytes()
    assert len(list(tmp_path.iterdir())) == 2


def test_an_npz_of_the_own_rig_is_the_motion_and_of_smplx_is_poses(tmp_path):
    formats.export(make(), tmp_path / "m.npz")
    np.testing.assert_array_equal(Motion.load(tmp_path / "m.npz").directions, make().directions)
    formats.export(make(), tmp_path / "x.npz", rig="smplx")
    with np.load(tmp_path / "x.npz") as arrays:
        assert arrays["poses"].shape == (9, 165)


def test_the_length_of_the_speech_is_noted(tmp_path):
    formats.export(make(), tmp_path / "a.glb")
    formats.export(make(), tmp_path / "b.glb", audio_seconds=0.75)
    assert b'"audio_seconds":0.61' in (tmp_path / "a.glb").read_bytes().replace(b" ", b"")
    assert b'"audio_seconds":0.75' in (tmp_path / "b.glb").read_bytes().replace(b" ", b"")


@pytest.mark.parametrize(
    ("name", "rig", "message"),
    [
        ("m.fbx", "ha2g", r"\.fbx; expected one of \.bvh"),
        ("m", "ha2g", "no suffix; expected one of"),
        ("m.bvh", "poser", "no rig poser"),
        ("m.vrma", "mixamo", "takes the rig vrm, not mixamo"),
        ("m.npz", "unity", "takes the rig ha2g or smplx, not unity"),
    ],
)
def test_what_cannot_be_written_is_named(tmp_path, name, rig, message):
    with pytest.raises(UserError, match=message) as error:
        formats.export(make(), tmp_path / name, rig=rig)
    assert "\n" not in str(error.value)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", formats.SUFFIXES)
def test_a_motion_that_is_none_leaves_no_file(tmp_path, suffix):
    motion = make()
    motion.directions[3, 5] = np.nan
    with pytest.raises(UserError):
        formats.export(motion, tmp_path / f"m{suffix}")
    assert not list(tmp_path.iterdir())


def test_a_place_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "folder.glb").mkdir()
    with pytest.raises(UserError, match="cannot write"):
        formats.export(make(), tmp_path / "folder.glb")
    assert [path.name for path in tmp_path.iterdir()] == ["folder.glb"]
