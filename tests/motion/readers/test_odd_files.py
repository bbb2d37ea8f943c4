"""Files that are slightly odd are read, and those that are wrong are refused in one line that names them."""

import numpy as np
import pytest

from ha2g_jax.errors import UserError
from ha2g_jax.motion.readers import read_motion


def crlf(text: str) -> str:
    return text.replace("\n", "\r\n")


def scientific(text: str) -> str:
    head, motion = text.split("Frame Time: ")
    rate, *rows = motion.splitlines()
    rows = [" ".join(f"{float(word):.6e}" for word in row.split()) for row in rows]
    return f"{head}Frame Time: {float(rate):.5e}\n" + "\n".join(rows) + "\n"


def six_channels(text: str) -> str:
    """Positions at every joint, equal to its offset, as Vicon and MotionBuilder write them."""
    offsets, lines, place = [], [], None
    for line in text.splitlines():
        words = line.split()
        if words[:1] == ["OFFSET"]:
            place = words[1:]
        if words[:2] == ["CHANNELS", "3"]:
            line = line.replace("CHANNELS 3", "CHANNELS 6 Xposition Yposition Zposition")
            offsets.append(place)
        elif words[:1] == ["CHANNELS"]:
            offsets.append(None)
        lines.append(line)
    start = next(index for index, line in enumerate(lines) if line.startswith("Frame Time")) + 1
    for index in range(start, len(lines)):
        words, found = lines[index].split(), []
        found += words[:6]
        for number, offset in enumerate(offsets[1:], start=2):
            found += [*offset, *words[3 * number : 3 * number + 3]]
        lines[index] = " ".join(found)
    return "\n".join(lines) + "\n"


def without_place(text: str) -> str:
    """Three channels at the root, too, as of files that stand still."""
    lines = text.replace("CHANNELS 6 Xposition Yposition Zposition", "CHANNELS 3").splitlines()
    start = next(index for index, line in enumerate(lines) if line.startswith("Frame Time")) + 1
    return "\n".join([*lines[:start], *(" ".join(line.split()[3:]) for line in lines[start:])]) + "\n"


def rotations_first(text: str) -> str:
    """The positions of the root behind its rotations."""
    channels = "CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation"
    behind = "CHANNELS 6 Zrotation Xrotation Yrotation Xposition Yposition Zposition"
    lines = text.replace(channels, behind).splitlines()
    start = next(index for index, line in enumerate(lines) if line.startswith("Frame Time")) + 1
    for index in range(start, len(lines)):
        words = lines[index].split()
        lines[index] = " ".join([*words[3:6], *words[:3], *words[6:]])
    return "\n".join(lines) + "\n"


def rows_on_two_lines(text):
    head, frames = text.split("Frame Time:")
    time, *rows = frames.splitlines()
    rows = [row.replace(" ", "\n", 1) for row in rows]
    return "\n".join([f"{head}Frame Time:{time}", *rows, ""])


ODD_BVH = {
    "CRLF": crlf,
    "tabs": lambda text: text.replace(" ", "\t"),
    "a byte order mark": lambda text: "\ufeff" + text,
    "scientific notation": scientific,
    "lower case": lambda text: text.replace("CHANNELS", "channels").replace("position", "POSITION"),
    "braces behind names": lambda text: text.replace("\n{", " {").replace("\n  {", " {"),
    "six channels at every joint": six_channels,
    "rotations before positions": rotations_first,
    "blank lines and spaces": lambda text: text.replace("\n", "  \n\n") + "\n\n \n",
    "no line at the end": lambda text: text.rstrip(),
    "no space behind Frames:": lambda text: text.replace("Frames: ", "Frames:"),
    "frames without a colon": lambda text: text.replace("Frames:", "Frames").replace("Frame Time:", "Frame Time"),
    "a plus sign": lambda text: text.replace("Frame Time: ", "Frame Time: +"),
    "one row on several lines": rows_on_two_lines,
}


@pytest.mark.parametrize("case", ODD_BVH)
def test_an_odd_bvh_is_the_same_motion(case, files, tmp_path):
    text = files["BVH"].read_text()
    changed = ODD_BVH[case](text)
    assert changed != text
    (tmp_path / "x.bvh").write_bytes(changed.encode())
    motion, expected = read_motion(tmp_path / "x.bvh"), read_motion(files["BVH"])
    np.testing.assert_allclose(motion.positions, expected.positions, atol=1e-4)
    assert motion.fps == pytest.approx(expected.fps)


def test_a_bvh_without_a_place_is_read(files, tmp_path):
    (tmp_path / "x.bvh").write_text(without_place(files["BVH"].read_text()))
    expected = read_motion(files["BVH"]).directions
    np.testing.assert_allclose(read_motion(tmp_path / "x.bvh").directions, expected, atol=1e-3)


@pytest.mark.parametrize("order", ["XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX"])
def test_every_order_of_rotations_is_read(order, files, tmp_path):
    from scipy.spatial.transform import Rotation

    lines = files["BVH"].read_text().splitlines()
    start = next(index for index, line in enumerate(lines) if line.startswith("Frame Time")) + 1
    given = " ".join(f"{axis}rotation" for axis in order)
    lines = [line.replace("Zrotation Xrotation Yrotation", given) for line in lines]
    values = np.array([line.split() for line in lines[start:]], float)
    turns = Rotation.from_euler("ZXY", values[:, 3:].reshape(-1, 3), degrees=True)
    values[:, 3:] = turns.as_euler(order, degrees=True).reshape(len(values), -1)
    rows = [" ".join(f"{value:.6f}" for value in row) for row in values]
    (tmp_path / "x.bvh").write_text("\n".join([*lines[:start], *rows]) + "\n")
    expected = read_motion(files["BVH"]).positions
    np.testing.assert_allclose(read_motion(tmp_path / "x.bvh").positions, expected, atol=1e-5)


def rows(text: str, count: int) -> str:
    """The BVH with its first frames only."""
    lines = text.splitlines()
    start = next(index for index, line in enumerate(lines) if line.startswith("Frame Time")) + 1
    lines = [f"Frames: {count}" if line.startswith("Frames") else line for line in lines[: start + count]]
    return "\n".join(lines) + "\n"


def test_one_frame_is_a_motion(files, tmp_path):
    (tmp_path / "x.bvh").write_text(rows(files["BVH"].read_text(), 1))
    with np.load(files["BEAT2"]) as arrays:
        np.savez(
            tmp_path / "x.npz", **{name: arrays[name][:1] if arrays[name].ndim > 1 else arrays[name] for name in arrays}
        )
    np.save(tmp_path / "x.npy", np.load(files["directions"])[:1])
    for name in ("x.bvh", "x.npz", "x.npy"):
        assert read_motion(tmp_path / name).num_frames == 1


WRONG_BVH = {
    "cut in the skeleton": (lambda text: text[:900], "x.bvh, line 41"),
    "cut in the motion": (lambda text: text[:-4000], "frame|ends|numbers"),
    "no frames": (lambda text: rows(text, 0), "Frames: '0'"),
    "huge count": (lambda text: text.replace("Frames: 60", "Frames: 1999999"), "frame|ends|numbers"),
    "no Frame Time": (lambda text: text.replace("Frame Time: 0.03333333\n", ""), "Frame Time"),
    "Frame Time 0": (lambda text: text.replace("0.03333333", "0"), "Frame Time"),
    "NaN": (lambda text: text[: text.rstrip().rindex(" ")] + " nan\n", "in frame 60 is 'nan'"),
    "a comma for a point": (lambda text: text.replace(".", ","), "expected"),
    "empty": (lambda text: "", "empty file"),
    "not a BVH": (lambda text: "HIERARCHY of needs", "expected"),
}


@pytest.mark.parametrize("case", WRONG_BVH)
def test_a_wrong_bvh_is_named(case, files, tmp_path):
    change, expected = WRONG_BVH[case]
    (tmp_path / "x.bvh").write_text(change(files["BVH"].read_text()))
    with pytest.raises(UserError, match=expected) as caught:
        read_motion(tmp_path / "x.bvh")
    assert "x.bvh" in str(caught.value) and "\n" not in str(caught.value)


def save(path, files, **changes):
    with np.load(files["BEAT2"]) as given:
        arrays = dict(given) | changes
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
    "facts of another program": {"model": np.array({"a": 1}, object), "labels": np.array([None, "a"], object)},
}


@pytest.mark.parametrize("case", ODD_NPZ)
def test_an_odd_npz_is_the_same_motion(case, files, tmp_path):
    save(tmp_path / "x.npz", files, **ODD_NPZ[case])
    motion, expected = read_motion(tmp_path / "x.npz"), read_motion(files["BEAT2"])
    np.testing.assert_allclose(motion.positions, expected.positions, atol=1e-5)
    assert motion.fps == 30


@pytest.mark.parametrize("kind", [np.float16, np.float32, ">f8", "F"])
def test_poses_of_any_float_are_read(kind, files, tmp_path):
    with np.load(files["BEAT2"]) as given:
        poses = given["poses"]
    poses = np.asfortranarray(poses) if kind == "F" else poses.astype(kind)
    save(tmp_path / "x.npz", files, poses=poses)
    expected = read_motion(files["BEAT2"]).positions
    np.testing.assert_allclose(read_motion(tmp_path / "x.npz").positions, expected, atol=2e-3)


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


def with_nan() -> np.ndarray:
    poses = np.zeros((60, 165))
    poses[7, 3] = np.nan
    return poses


WRONG_NPZ = {
    "NaN": ({"poses": with_nan()}, "frame 8 of poses"),
    "objects": ({"poses": np.zeros((60, 165), object)}, "poses|object|pickle"),
    "text": ({"poses": np.zeros((60, 165), "U1")}, "poses"),
    "no frames": ({"poses": np.zeros((0, 165)), "trans": np.zeros((0, 3))}, "poses"),
    "SMPL": ({"poses": np.zeros((60, 72))}, r"poses has shape \(60, 72\)"),
    "two lengths": ({"trans": np.zeros((59, 3))}, r"trans has shape \(59, 3\)"),
    "rate of no number": ({"mocap_frame_rate": np.array("fast")}, "mocap_frame_rate is 'fast'"),
    "rate 0": ({"mocap_frame_rate": np.array(0)}, "mocap_frame_rate is"),
    "rate NaN": ({"mocap_frame_rate": np.array("nan")}, "mocap_frame_rate is"),
    "no rate": ({"mocap_frame_rate": None}, "no frame rate"),
    "a number": ({"poses": np.array(3.0)}, "poses"),
    "complex numbers": ({"poses": np.zeros((60, 165), complex)}, "poses"),
}


@pytest.mark.parametrize("case", WRONG_NPZ)
def test_a_wrong_npz_is_named(case, files, tmp_path):
    changes, expected = WRONG_NPZ[case]
    save(tmp_path / "x.npz", files, **changes)
    with pytest.raises(UserError, match=expected) as caught:
        read_motion(tmp_path / "x.npz")
    assert "x.npz" in str(caught.value) and "\n" not in str(caught.value)


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


@pytest.mark.parametrize("header", [(10**9, 126), (10**12, 126), (2**62, 126)])
def test_a_header_of_huge_counts_is_refused_before_memory_is_taken(header, tmp_path):
    import struct

    text = f"{{'descr': '<f4', 'fortran_order': False, 'shape': {header}, }}".ljust(117) + "\n"
    (tmp_path / "x.npy").write_bytes(b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text.encode() + b"\0" * 64)
    with pytest.raises(UserError, match=r"x\.npy"):
        read_motion(tmp_path / "x.npy")


def test_an_archive_that_begins_as_a_npy_file_is_refused(tmp_path):
    np.savez(tmp_path / "two.npz", a=np.zeros(3), b=np.zeros(3))
    (tmp_path / "x.npy").write_bytes(b" \x93NUMPY" + (tmp_path / "two.npz").read_bytes())
    with pytest.raises(UserError, match=r"x\.npy contains 2 arrays"):
        read_motion(tmp_path / "x.npy")
