"""Every consumer of a motion file answers any file: with its result, or with one line."""

import io
import json
import os
import pathlib
import struct
import zipfile
from typing import Any

import numpy as np
import pytest
from fixtures.motions import swaying
from fuzz.conftest import within_limits
from fuzz.mutation import FUZZ, damaged_bytes, damaged_tree
from hypothesis import given
from hypothesis import strategies as st

from ha2g_jax import cli
from ha2g_jax.errors import UserError
from ha2g_jax.motion.formats import export, keyframes
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.readers import read_motion
from ha2g_jax.skeleton import load_skeleton
from ha2g_jax.viewer import view

SKELETON = load_skeleton("ted_gesture")


def make_motion(frames: int = 6) -> Motion:
    return swaying(SKELETON.name, frames, size=0.2, speech="a.wav", duration=0.4, borders=[2, 4])


def arrays_of(motion: Motion) -> dict[str, np.ndarray]:
    """Return the arrays of a file of a motion."""
    lower = {
        "lower_offsets": np.full((10, 3), 0.1),
        "lower_rotations": np.tile([0.0, 0.0, 0.0, 1.0], (motion.num_frames, 9, 1)),
        "lower_translation": np.ones((motion.num_frames, 3)),
    }
    return {
        **lower,
        "face_jaw": np.zeros((motion.num_frames, 3)),
        "directions": motion.directions,
        "positions": motion.positions,
        "fps": np.array(motion.fps),
        "joint_names": np.array(motion.joint_names),
        "meta": np.array(json.dumps(motion.meta)),
    }


GOOD = arrays_of(make_motion())
TABLE = {"fps": 15.0, "joint_names": list(SKELETON.joints), "positions": make_motion().positions.tolist()}


def npz(arrays: dict[str, Any]) -> bytes:
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


def declaring(shape: tuple[int, ...]) -> bytes:
    """Return a file whose directions say that they have another shape than they have."""
    header, file = io.BytesIO(), io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f4", "fortran_order": False, "shape": shape})
    with zipfile.ZipFile(file, "w") as archive, zipfile.ZipFile(io.BytesIO(npz(GOOD))) as good:
        for name in good.namelist():
            archive.writestr(name, header.getvalue() if name == "directions.npy" else good.read(name))
    return file.getvalue()


def bomb(num_bytes: int) -> bytes:
    """Return a file whose table of contents says that its directions unpack to so many bytes."""
    content = bytearray(npz(GOOD))
    struct.pack_into("<I", content, content.find(b"PK\x01\x02") + 24, num_bytes)
    return bytes(content)


def changed(values: np.ndarray, value: float) -> np.ndarray:
    values = values.copy()
    values[2, 3] = value
    return values


def copy(path: pathlib.Path) -> None:
    """Read a motion and write what has a copy of its facts."""
    motion = Motion.load(path)
    motion.save(path.with_name("out.npz"))
    export(motion, path.with_name("out.vrma"))


def consume(path: pathlib.Path) -> None:
    """Read a motion and do with it what the commands do."""
    motion = Motion.load(path)
    for suffix in (".glb", ".bvh", ".json"):
        export(motion, path.with_name(f"out{suffix}"))
    keyframes.write(path.with_name("out.svg"), motion, count=2, size=64)
    view(motion)


@st.composite
def odd_array(draw: st.DrawFn, values: np.ndarray) -> np.ndarray:
    """Draw an array with another shape, type or value."""
    odd = draw(st.sampled_from((np.nan, np.inf, 0.0, -1.0, 1e-300, 1e-4, 1e12, 1e300, 1e30)))
    match draw(st.integers(0, 5)):
        case 0:
            return values[..., : draw(st.integers(0, 2))] if values.ndim else np.array([values, values])
        case 1:
            kinds = ("U8", "S8", "f2", "f8", "?") if values.dtype.kind == "f" else ("U8", "S8")
            return values.astype(draw(st.sampled_from(kinds))) if values.ndim else values[None]
        case 2:
            return np.array(odd)
        case 3:
            return values[: draw(st.integers(0, 2))] if values.ndim else np.zeros(3)
        case 4 if values.dtype.kind == "f":
            return np.where(np.arange(values.size).reshape(values.shape) == 7 % values.size, np.float64(odd), values)
        case _:
            return np.array(draw(st.sampled_from(("", "x" * 5000, "{}", "[1]", "3", '{"skeleton": []}', "\ud800"))))


@FUZZ
@given(data=st.data())
def test_damaged_bytes_are_answered(data, answered):
    answered(consume, data.draw(damaged_bytes(npz(GOOD))), "m.npz")


@FUZZ
@given(data=st.data())
def test_odd_arrays_are_answered(data, answered):
    odd = {name: data.draw(odd_array(GOOD[name])) for name in data.draw(st.sets(st.sampled_from(sorted(GOOD))))}
    answered(consume, npz(GOOD | odd), "m.npz")


@FUZZ
@given(data=st.data())
def test_damaged_meta_is_answered(data, answered):
    meta = data.draw(damaged_tree(make_motion().meta | {"more": {"list": [1, "a", {"x": 0.5}]}}))
    answered(copy, npz(arrays_of(make_motion(1)) | {"meta": np.array(json.dumps(meta))}), "m.npz")


def read_any(path: pathlib.Path) -> None:
    """Read a file of any kind and write what was read."""
    motion = read_motion(path, source_fps=15)
    motion.save(path.with_name("out.npz"))
    export(motion, path.with_name("x.npz"), rig="smplx")


SMPLX = {
    "poses": np.full((6, 165), 0.1),
    "trans": np.ones((6, 3)),
    "betas": np.zeros(10),
    "expressions": np.zeros((6, 100)),
    "mocap_frame_rate": np.array(30.0),
}


@FUZZ
@given(data=st.data())
def test_odd_smplx_is_answered(data, answered):
    odd = {name: data.draw(odd_array(SMPLX[name])) for name in data.draw(st.sets(st.sampled_from(sorted(SMPLX))))}
    answered(read_any, npz(SMPLX | odd), "m.npz")


@FUZZ
@given(data=st.data())
def test_odd_direction_arrays_are_answered(data, answered):
    file = io.BytesIO()
    np.save(file, data.draw(odd_array(GOOD["directions"])))
    content = file.getvalue()
    answered(read_any, data.draw(st.one_of(st.just(content), damaged_bytes(content))), "m.npy")


def score(path: pathlib.Path) -> None:
    read_motion(path, skeleton=SKELETON.name, fps=15)


@FUZZ
@given(data=st.data())
def test_damaged_motion_is_answered_by_evaluate(data, answered):
    answered(score, data.draw(damaged_bytes(npz(GOOD))), "m.npz")
    names = data.draw(st.sets(st.sampled_from(("positions", "fps", "joint_names", "borders"))))
    plain = {name: GOOD[name] for name in ("positions", "fps", "joint_names")} | {"borders": np.array([2, 4])}
    answered(score, npz(plain | {name: data.draw(odd_array(plain[name])) for name in sorted(names)}), "m.npz")


@FUZZ
@given(data=st.data())
def test_damaged_json_is_answered_by_evaluate(data, answered):
    answered(score, json.dumps(data.draw(damaged_tree(TABLE | {"borders": [1, 2]}))).encode(), "m.json")
    answered(score, data.draw(damaged_bytes(json.dumps(TABLE).encode())), "m.json")


DEEP = '{"a":' * 200_000 + "1" + "}" * 200_000
CASES: dict[str, tuple[dict[str, Any], str]] = {
    "deep meta": ({"meta": np.array("[" * 200_000 + "]" * 200_000)}, "nested too deep"),
    "deep objects": ({"meta": np.array(DEEP)}, "more than the 1048576 allowed"),
    "meta is a list": ({"meta": np.array("[1]")}, "meta is a list"),
    "meta is a number": ({"meta": np.array(1.5)}, "meta is a float"),
    "skeleton is a list": ({"meta": np.array('{"skeleton": ["ted_gesture"]}')}, "expected ted_expressive or"),
    "fewer names": ({"joint_names": GOOD["joint_names"][:3]}, "3 joints, not the 10"),
    "many names": ({"joint_names": np.zeros(100_000, "U1")}, "joint_names of shape (100000,)"),
    "NaN": ({"directions": changed(GOOD["directions"], np.nan)}, "in frame 2 is not a number"),
    "infinity": ({"positions": changed(GOOD["positions"], np.inf)}, "in frame 2 is not a number"),
    "huge": ({"directions": changed(GOOD["directions"], 1e30)}, "a direction of length 1e+30"),
    "no length": ({"positions": np.zeros_like(GOOD["positions"])}, "is 0 m long"),
    "no frames": ({"directions": GOOD["directions"][:0], "positions": GOOD["positions"][:0]}, "0 frames"),
    "other lengths": ({"positions": GOOD["positions"][:3]}, "positions are float32 of shape (3, 10, 3)"),
    "no axes": ({"directions": np.array(1.0)}, "of shape ()"),
    "too slow": ({"fps": np.array(1e-4)}, "expected 0.1 to 1000"),
    "too fast": ({"fps": np.array(1e12)}, "expected 0.1 to 1000"),
    "no rate": ({"fps": np.array(np.nan)}, "expected 0.1 to 1000"),
    "two rates": ({"fps": np.array([15.0, 15.0])}, "not a motion"),
    "hours": (
        {name: np.repeat(GOOD[name][:1], 10_000, axis=0) for name in ("directions", "positions")}
        | {"fps": np.array(1.0)},
        "10000 seconds",
    ),
}
COMMANDS = (
    ("export", "{}", "-o", "{out}/x.glb"),
    ("view", "{}", "-o", "{out}/x.html"),
    ("video", "{}", "-o", "{out}/x.mp4"),
    ("keyframes", "{}", "-o", "{out}/x.png"),
    ("generate", "none.wav", "--pin", "0:1:{}"),
    ("evaluate", "--motion", "{folder}", "--reference", "{folder}"),
)


@pytest.mark.parametrize("name", CASES)
def test_every_command_refuses_it_in_one_line(name, refused, tmp_path):
    changes, what = CASES[name]
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "m.npz").write_bytes(npz(GOOD | changes))
    for command in COMMANDS:
        line = refused(
            *(word.format(tmp_path / "in" / "m.npz", folder=tmp_path / "in", out=tmp_path / "out") for word in command)
        )
        assert what in line and "m.npz" in line, line
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("shape", "what"), [((10**12, 9, 3), "needs 108000000000000 bytes"), ((10**12, 0, 3), "shape")]
)
def test_a_million_million_frames_are_refused(shape, what, refused, tmp_path):
    (tmp_path / "m.npz").write_bytes(declaring(shape))
    assert what in refused("view", str(tmp_path / "m.npz"), "-o", str(tmp_path / "x.html"))
    assert what in refused("evaluate", "--motion", str(tmp_path), "--reference", str(tmp_path))


def test_a_bomb_is_not_unpacked(refused, tmp_path):
    (tmp_path / "m.npz").write_bytes(bomb(0xF0000000))
    assert "more than the 1073741824 allowed" in refused(
        "evaluate", "--motion", str(tmp_path), "--reference", str(tmp_path)
    )


@pytest.mark.parametrize(
    ("content", "what"),
    [
        (DEEP.encode(), "nested too deep"),
        (json.dumps(TABLE | {"fps": 1e-300}).encode(), "expected 0.1 to 1000"),
        (json.dumps(TABLE | {"borders": [1e300]}).encode(), "borders that are not whole numbers from 0 to 6"),
        (json.dumps(TABLE | {"joint_names": ["x\n\ud800"] * 10}).encode(), "lacks spine"),
        (json.dumps(TABLE | {"positions": [[[10**400] * 3] * 10]}).encode(), "holds no motion"),
        (
            json.dumps(TABLE | {"positions": (1e200 * make_motion().positions.astype(float)).tolist()}).encode(),
            "at most",
        ),
        (b" " * ((1 << 25) + 1), "more than 33554432 bytes"),
    ],
)
def test_json_that_is_no_motion_is_refused(content, what, refused, tmp_path):
    (tmp_path / "m.json").write_bytes(content)
    assert what in refused("evaluate", "--motion", str(tmp_path), "--reference", str(tmp_path))


def test_a_bvh_is_no_start_of_a_motion(tmp_path):
    (tmp_path / "x.bvh").write_text("HIERARCHY\n")
    with pytest.raises(UserError, match="ha2g export takes a BVH"):
        Motion.load(tmp_path / "x.bvh")


OUTPUTS = {
    ".glb": ("export",), ".vrma": ("export",), ".bvh": ("export",), ".json": ("export",), ".csv": ("export",),
    ".npz": ("export",), ".html": ("view",), ".svg": ("keyframes", "--size", "64"),
    ".png": ("keyframes", "--size", "64"), ".mp4": ("video", "--size", "64x64"),
}  # fmt: skip


@pytest.mark.parametrize("suffix", OUTPUTS)
def test_a_full_disk_is_one_line_and_leaves_nothing(suffix, refused, tmp_path):
    make_motion().save(tmp_path / "m.npz")
    (tmp_path / "out").mkdir()
    # The temporary file is one that accepts no byte.
    (tmp_path / "out" / f".x.{os.getpid()}{suffix}").symlink_to("/dev/full")
    command, *options = OUTPUTS[suffix]
    line = refused(command, str(tmp_path / "m.npz"), *options, "-o", str(tmp_path / "out" / f"x{suffix}"))
    assert "no space left on device" in line
    assert not list((tmp_path / "out").iterdir())


@pytest.mark.parametrize("suffix", OUTPUTS)
def test_any_name_of_a_file_is_answered(suffix, refused, capsys, tmp_path):
    odd = "\udcff\n"
    make_motion().save(tmp_path / f"{odd}.npz")
    command, *options = OUTPUTS[suffix]
    with within_limits():
        out = tmp_path / f"out{odd}{suffix}"
        assert cli.main([command, str(tmp_path / f"{odd}.npz"), *options, "-o", str(out)]) == 0
    assert out.is_file()
    assert capsys.readouterr().out
    for source, target in (("a" * 300, "x"), (odd, "a" * 300)):
        paths = str(tmp_path / f"{source}.npz"), "-o", str(tmp_path / f"{target}{suffix}")
        assert "file name too long" in refused(command, *paths, *options).lower()
