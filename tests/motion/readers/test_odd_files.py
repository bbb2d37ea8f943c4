"""Arrays that are slightly odd are read, and what is wrong is refused in one line; for BVH see test_bvh."""

import struct

import numpy as np
import pytest
from motion.readers import bvh_files

from ha2g_jax.errors import UserError
from ha2g_jax.motion.readers import read_motion


def test_one_frame_is_a_motion(files, tmp_path):
    (tmp_path / "x.bvh").write_text(bvh_files.first_frames(files["BVH"].read_text(), 1))
    with np.load(files["BEAT2"]) as arrays:
        first = {name: array[:1] if array.ndim > 1 else array for name, array in arrays.items()}
    np.savez(tmp_path / "x.npz", **first)
    np.save(tmp_path / "x.npy", np.load(files["directions"])[:1])
    for name in ("x.bvh", "x.npz", "x.npy"):
        assert read_motion(tmp_path / name).num_frames == 1


def save(path, files, **changes):
    with np.load(files["BEAT2"]) as given:
        arrays = dict(given)
    arrays |= {name: change(arrays[name]) if callable(change) else change for name, change in changes.items()}
    np.savez(path, **{name: values for name, values in arrays.items() if values is not None})


ODD_NPZ = {
    "gender as bytes": {"gender": np.array(b"neutral")},
    "gender as an object": {"gender": np.array("neutral", object)},
    "rate as text": {"mocap_frame_rate": np.array("30")},
    "rate as bytes": {"mocap_frame_rate": np.array(b"30.0")},
    "rate in an array": {"mocap_frame_rate": np.array([[30.0]])},
    "rate as an int32": {"mocap_frame_rate": np.array(30, np.int32)},
    "no betas": {"betas": None},
    "betas of each frame": {"betas": np.zeros((60, 300))},
    "betas in a row": {"betas": np.zeros((1, 300))},
    "no trans": {"trans": None},
    "no face": {"expressions": None},
    "half floats": {"poses": lambda poses: poses.astype(np.float16)},
    "big-endian floats": {"poses": lambda poses: poses.astype(">f8")},
    "poses by columns": {"poses": np.asfortranarray},
    "facts of another program": {"model": np.array({"a": 1}, object), "labels": np.array([None, "a"], object)},
}


@pytest.mark.parametrize("case", ODD_NPZ)
def test_an_odd_npz_is_the_same_motion(case, files, tmp_path):
    save(tmp_path / "x.npz", files, **ODD_NPZ[case])
    motion, expected = read_motion(tmp_path / "x.npz"), read_motion(files["BEAT2"])
    np.testing.assert_allclose(motion.positions, expected.positions, atol=2e-3 if case == "half floats" else 1e-5)
    assert motion.fps == 30


NAMES = {
    "bytes": lambda names: names.astype(bytes),
    "in a column": lambda names: names[:, None],
    "in capitals": np.char.upper,
}


@pytest.mark.parametrize("case", NAMES)
def test_names_of_joints_in_another_form_are_read(case, files, tmp_path):
    with np.load(files["named positions npz"]) as arrays:
        names = NAMES[case](arrays["joint_names"])
        np.savez(tmp_path / "x.npz", **{**arrays, "joint_names": names, "borders": [30.0, 9, 30]})
    motion, expected = read_motion(tmp_path / "x.npz"), read_motion(files["named positions npz"])
    np.testing.assert_array_equal(motion.positions, expected.positions)
    assert motion.meta["borders"] == [9, 30]


def test_borders_between_frames_are_refused(files, tmp_path):
    with np.load(files["named positions npz"]) as arrays:
        np.savez(tmp_path / "x.npz", **arrays, borders=[9.5])
    with pytest.raises(UserError, match="borders that are not whole numbers from 0 to 60"):
        read_motion(tmp_path / "x.npz")


@pytest.mark.parametrize("kind", ["BEAT2", "own", "directions", "named positions"])
@pytest.mark.parametrize("part", [0.0, 0.01, 0.5, 0.99])
def test_a_file_that_is_cut_is_refused(kind, part, files, tmp_path):
    data = files[kind].read_bytes()
    path = tmp_path / f"x{files[kind].suffix}"
    path.write_bytes(data[: int(part * len(data))])
    with pytest.raises(UserError) as caught:
        read_motion(path)
    assert path.name in str(caught.value) and "\n" not in str(caught.value)


def test_positions_without_names_of_joints_are_refused(tmp_path):
    (tmp_path / "a.json").write_text('{"positions": [[[0, 0, 0]], [[0, 0, 0]]], "fps": 15}')
    with pytest.raises(UserError, match=r"a\.json"):
        read_motion(tmp_path / "a.json")


@pytest.mark.parametrize("header", [(10**9, 126), (2**62, 126)])
def test_a_header_of_huge_counts_is_refused_before_memory_is_taken(header, tmp_path):
    text = f"{{'descr': '<f4', 'fortran_order': False, 'shape': {header}, }}".ljust(117) + "\n"
    (tmp_path / "x.npy").write_bytes(b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text.encode() + b"\0" * 64)
    with pytest.raises(UserError, match=r"x\.npy"):
        read_motion(tmp_path / "x.npy")


def test_an_archive_that_begins_as_a_npy_file_is_refused(tmp_path):
    np.savez(tmp_path / "two.npz", a=np.zeros(3), b=np.zeros(3))
    (tmp_path / "x.npy").write_bytes(b" \x93NUMPY" + (tmp_path / "two.npz").read_bytes())
    with pytest.raises(UserError, match=r"x\.npy contains 2 arrays"):
        read_motion(tmp_path / "x.npy")
