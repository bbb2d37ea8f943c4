"""Motion capture and joint maps of any content, and files of any name, are read or refused."""

import json
import pathlib

import numpy as np
import pytest
import soundfile
from fuzz.conftest import within_limits
from fuzz.mutation import FUZZ, damaged_bytes, damaged_text
from hypothesis import given
from hypothesis import strategies as st
from motion.readers import bvh_files

from ha2g_jax.data.corpus import Corpus
from ha2g_jax.errors import UserError
from ha2g_jax.files.reading import shown
from ha2g_jax.importers.mocap import import_bvh
from ha2g_jax.motion.readers.bvh_motion import read_motion
from ha2g_jax.motion.readers.joint_maps import load_map
from ha2g_jax.motion.readers.smplx import read_smplx
from ha2g_jax.motion.readers.smplx_body import template
from ha2g_jax.skeleton import load_skeleton

GESTURE = load_skeleton("ted_gesture")
ODD = "t\udcff\udce9 lk"


def bvh(seconds: float) -> str:
    return bvh_files.bvh(bvh_files.swing(seconds, 30, with_fingers=False))


BVH = bvh(0.2)
BODY = template()


def read_bvh_motion(path: pathlib.Path) -> None:
    motion = read_motion(path, GESTURE, fps=15)
    assert np.isfinite(motion.positions).all()


def read_poses(path: pathlib.Path) -> None:
    assert np.isfinite(read_smplx(path, GESTURE, BODY, fps=15).positions).all()


@FUZZ
@given(content=st.one_of(damaged_text(BVH), damaged_bytes(BVH.encode())))
def test_bvh(content, answered):
    answered(read_bvh_motion, content, "a.bvh")


HEADERS = ["0", "-1", "1e9", str(10**9), str(10**30), "nan", "inf", "1e-300", "1e300", "0.001", "10", "1,5", "x", ""]


@FUZZ
@given(frames=st.sampled_from(HEADERS), frame_time=st.sampled_from(HEADERS))
def test_headers_of_bvh(frames, frame_time, answered):
    lines = BVH.splitlines()
    place = lines.index("MOTION")
    lines[place + 1 : place + 3] = [f"Frames: {frames}", f"Frame Time: {frame_time}"]
    answered(read_bvh_motion, "\n".join(lines).encode(), "a.bvh")


def test_a_thousand_joints_in_a_chain(tmp_path):
    joints = [
        f"{'JOINT' if i else 'ROOT'} j{i}\n{{\nOFFSET 0 1 0\nCHANNELS 3 Xrotation Yrotation Zrotation\n"
        for i in range(1000)
    ]
    motion = f"MOTION\nFrames: 1\nFrame Time: 0.03333\n{'0 ' * 3000}"
    (tmp_path / "a.bvh").write_text(f"HIERARCHY\n{''.join(joints)}{'}' * 1000}\n{motion}")
    with within_limits(), pytest.raises(UserError, match="does not fit the joint map"):
        read_bvh_motion(tmp_path / "a.bvh")


@FUZZ
@given(data=st.data())
def test_smplx(data, answered, tmp_path):
    arrays = {"poses": np.zeros((9, 165)), "trans": np.zeros((9, 3)), "betas": np.zeros(10), "fps": np.array(30)}
    if data.draw(st.booleans()):
        arrays = {"joints": np.random.default_rng(0).normal(size=(9, 55, 3)), "fps": np.array(30)}
    name = data.draw(st.sampled_from(list(arrays)))
    odd = [
        np.array(1e-300),
        np.array(0.1),
        np.array(np.nan),
        np.zeros((0, 165)),
        np.full((9, 165), 1e300),
        np.array("x"),
    ]
    arrays[name] = data.draw(st.sampled_from([*odd, arrays[name], arrays[name][..., None], arrays[name].astype(bool)]))
    np.savez(tmp_path / "whole.npz", **arrays)
    content = (tmp_path / "whole.npz").read_bytes()
    answered(read_poses, data.draw(st.sampled_from([content, data.draw(damaged_bytes(content))])), "a.npz")


MAP = "spine: [Spine3, Chest]\nneck: Neck\nhead: Head\nleft_shoulder: LeftArm\nunit: 0.01\nup: y\n"
JSON_MAP = json.dumps({"spine": ["Spine3", "Chest"], "neck": "Neck", "unit": 0.01, "up": "y"})
LAUGHS = "a0: &a0 [x, x, x, x, x, x, x, x]\n" + "".join(f"a{i}: &a{i} [{f'*a{i - 1}, ' * 8}]\n" for i in range(1, 30))
MAPS = {
    "laughs": (LAUGHS + "up: *a29", "an alias"),
    "merges": ("a: &a {x: y}\nb: {<<: *a}\n", "an alias"),
    "depth": ("[" * 30_000, "nested too deep"),
    "maps": ("".join(f"{' ' * i}a:\n" for i in range(200)), "nested too deep"),
    "digits": ("spine: 0x" + "f" * 60_000, "more than 200 characters"),
    "unit": ("unit: 0x" + "f" * 60_000, "has `unit"),
    "up": ("up: 0x" + "f" * 60_000, "has `up"),
    "name": ("spine: " + "x" * 60_000, "more than 200 characters"),
}


@FUZZ
@given(
    content=st.one_of(damaged_text(MAP), damaged_text(JSON_MAP), damaged_bytes(MAP.encode())),
    suffix=st.sampled_from([".yaml", ".json"]),
)
def test_joint_maps(content, suffix, answered):
    answered(lambda path: load_map(str(path)), content, f"a{suffix}")


@pytest.mark.parametrize("case", MAPS)
def test_a_joint_map_that_unfolds(case, tmp_path):
    content, found = MAPS[case]
    (tmp_path / "a.yaml").write_text(content)
    with within_limits(), pytest.raises(UserError, match=found):
        load_map(str(tmp_path / "a.yaml"))


def write_recording(folder: pathlib.Path, stem: str) -> pathlib.Path:
    folder.mkdir()
    (folder / f"{stem}.bvh").write_text(bvh(6.0))
    with (folder / f"{stem}.wav").open("wb") as file:
        soundfile.write(file, np.random.default_rng(0).normal(0, 0.1, 96_000), 16_000, format="WAV")
    rows = [f"{0.5 * i}\t{0.5 * i + 0.4}\tword{i}" for i in range(12)]
    (folder / f"{stem}.tsv").write_text("\n".join(["start\tend\tword", *rows]))
    return folder / f"{stem}.bvh"


def test_a_name_that_is_not_utf8_is_imported_as_text(tmp_path, refused):
    from ha2g_jax.importers.mocap import ImportOptions

    path = write_recording(tmp_path / ODD, ODD)
    import_bvh(path, tmp_path / "out", ImportOptions(skeleton="ted_gesture"))
    corpus = Corpus.open(tmp_path / "out")
    (clip,) = corpus.clips("train")
    assert clip.recording == clip.speaker == shown(ODD) == "t\\xff\\xe9 lk"
    json.dumps(corpus.metadata, ensure_ascii=False).encode()
    assert "not UTF-8" in refused(
        "data", "split", str(tmp_path / "out"), str(tmp_path / f"x{ODD}"), "--fractions", "1", "0", "0"
    )
