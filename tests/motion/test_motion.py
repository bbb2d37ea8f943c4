"""The motion file has the promised arrays, no pickle, the same bytes, and is whole or not there."""

import io
import json
import zipfile

import numpy as np
import pytest

from ha2g_jax.errors import UserError
from ha2g_jax.files.writing import whole_file
from ha2g_jax.motion.motion import Motion
from ha2g_jax.skeleton import SKELETONS, load_skeleton


def make(name: str = "ted_expressive", frames: int = 5) -> Motion:
    skeleton = load_skeleton(name)
    directions = np.random.default_rng(0).normal(size=(frames, skeleton.num_bones, 3))
    return Motion.from_directions(skeleton, directions, 15, {"seed": 3, "speech": "gr\u00fc\u00dfe.wav"})


@pytest.mark.parametrize("name", SKELETONS)
def test_positions_follow_from_directions_and_bone_lengths(name):
    motion = make(name)
    skeleton = load_skeleton(name)
    assert motion.directions.dtype == motion.positions.dtype == np.float32
    np.testing.assert_allclose(motion.skeleton.lengths, skeleton.lengths, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(motion.directions, axis=-1), 1, atol=1e-6)
    np.testing.assert_array_equal(motion.positions[:, 0], 0)
    parents, children = np.array(skeleton.bones).T
    lengths = np.linalg.norm(motion.positions[:, children] - motion.positions[:, parents], axis=-1)
    np.testing.assert_allclose(lengths, np.broadcast_to(skeleton.lengths, lengths.shape), atol=1e-6)


def test_meta_says_where_the_axes_point():
    assert make("ted_expressive").meta["axes"]["x"] == "the person's left"
    assert make("ted_gesture").meta["axes"]["x"] == "the person's right"


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
    assert meta["axes"]["y"] == "down"


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


def test_a_file_of_ten_million_frames_is_refused_before_it_is_read(tmp_path):
    """The file says that it holds 5 GB of directions and has none."""
    header = io.BytesIO()
    facts = {"descr": "<f4", "fortran_order": False, "shape": (10_000_000, 42, 3)}
    np.lib.format.write_array_header_1_0(header, facts)
    with zipfile.ZipFile(tmp_path / "m.npz", "w") as archive:
        archive.writestr("directions.npy", header.getvalue())
    with pytest.raises(UserError, match="needs 5040000000 bytes"):
        Motion.load(tmp_path / "m.npz")


def test_a_file_is_whole_or_not_there(tmp_path):
    path = tmp_path / "new" / "x.txt"
    with pytest.raises(KeyboardInterrupt), whole_file(path) as temporary:
        temporary.write_text("half")
        raise KeyboardInterrupt
    assert list(tmp_path.iterdir()) == []
    with whole_file(path) as temporary:
        assert temporary.suffix == ".txt"
        temporary.write_text("whole")
    assert path.read_text() == "whole"
    assert list(path.parent.iterdir()) == [path]


def test_a_place_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "file").touch()
    (tmp_path / "folder.npz").mkdir()
    for path in (tmp_path / "file" / "m.npz", tmp_path / "folder.npz"):
        with pytest.raises(UserError, match="cannot write"):
            make().save(path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "folder.npz"]
