"""The motion file has the promised arrays, no pickle, the same bytes, and is whole or not there."""

import dataclasses
import json

import numpy as np
import pytest

from ha2g_jax.errors import UserError
from ha2g_jax.motion.motion import Motion
from ha2g_jax.skeleton import load_skeleton


def make(name: str = "ted_expressive", frames: int = 5) -> Motion:
    skeleton = load_skeleton(name)
    directions = np.random.default_rng(0).normal(size=(frames, skeleton.num_bones, 3))
    return Motion.from_directions(skeleton, directions, 15, {"seed": 3, "speech": "gr\u00fc\u00dfe.wav"})


def test_positions_follow_from_directions_and_bone_lengths(skeleton):
    motion = make(skeleton.name)
    assert motion.directions.dtype == motion.positions.dtype == np.float32
    np.testing.assert_allclose(motion.skeleton.lengths, skeleton.lengths, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(motion.directions, axis=-1), 1, atol=1e-6)
    np.testing.assert_array_equal(motion.positions[:, 0], 0)
    parents, children = np.array(skeleton.bones).T
    lengths = np.linalg.norm(motion.positions[:, children] - motion.positions[:, parents], axis=-1)
    np.testing.assert_allclose(lengths, np.broadcast_to(skeleton.lengths, lengths.shape), atol=1e-6)


def test_the_file_holds_plain_arrays(tmp_path):
    motion = make()
    motion.save(tmp_path / "m.npz")
    with np.load(tmp_path / "m.npz", allow_pickle=False) as arrays:
        assert set(arrays) == {"directions", "positions", "fps", "joint_names", "meta"}
        assert arrays["directions"].shape == (5, 42, 3)
        assert arrays["positions"].shape == (5, 43, 3)
        assert arrays["fps"] == 15
        assert tuple(arrays["joint_names"]) == motion.skeleton.joints
        meta = json.loads(str(arrays["meta"]))
    assert meta["seed"] == 3
    assert (meta["axes"]["x"], meta["axes"]["y"]) == ("the person's left", "down")
    assert make("ted_gesture").meta["axes"]["x"] == "the person's right"


def test_the_same_motion_gives_the_same_bytes_and_comes_back(tmp_path):
    motion = make()
    motion.save(tmp_path / "a.npz")
    Motion.load(tmp_path / "a.npz").save(tmp_path / "b.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    assert Motion.load(tmp_path / "b.npz").meta == motion.meta


def test_other_suffixes_and_other_files_are_refused(tmp_path):
    for name in ("m.txt", "m.bvh", "m"):
        with pytest.raises(UserError, match=rf"writes \.npz, not '{name}'; .*formats\.export\(motion, '{name}'\)"):
            make().save(tmp_path / name)
    assert not list(tmp_path.iterdir())
    (tmp_path / "text.npz").write_text("hello")
    np.savez(tmp_path / "other.npz", x=np.zeros(3))
    for name in ("missing.npz", "text.npz", "other.npz"):
        with pytest.raises(UserError, match=name):
            Motion.load(tmp_path / name)
    with pytest.raises(UserError, match="too long"):
        Motion.load("x" * 300)
    make().save(tmp_path / "m.npz")
    assert Motion.load((tmp_path / "m.npz").rename(tmp_path / "m.bak")).num_frames == make().num_frames
    for name in ("m.glb", "m.json"):
        (tmp_path / name).write_text("{}")
        with pytest.raises(UserError, match=rf"ha2g export .*{name} --out MOTION\.npz"):
            Motion.load(tmp_path / name)


@pytest.mark.parametrize(("name", "width"), [("jaw", 1), ("jaw", 4), ("arkit", 10)])
def test_a_face_of_another_width_is_refused(name, width):
    motion = make()
    with pytest.raises(UserError, match=rf"face_{name} are float32 of shape \(5, {width}\)"):
        dataclasses.replace(motion, face={name: np.zeros((5, width), np.float32)}).check()


def test_what_could_not_be_read_is_not_written(tmp_path):
    with pytest.raises(ValueError, match="not JSON compliant"):
        dataclasses.replace(make(), meta=make().meta | {"loss": float("nan")}).save(tmp_path / "m.npz")
    assert not list(tmp_path.iterdir())
