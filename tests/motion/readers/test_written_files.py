"""What the package writes it reads: each rig in each format, unit and with any names, at the joints of the file.

A rig holds a joint where it has the place of it. What it lacks is left out: knuckles in front of the bones of a palm,
and the face, of which it has the rotation of the head.
"""

import csv
import dataclasses
import json
import re

import numpy as np
import pytest
from fixtures.glb_reader import join_glb, split_glb
from fixtures.motions import swaying
from hypothesis import given, settings
from hypothesis import strategies as st

from ha2g_jax.errors import UserError
from ha2g_jax.motion import formats, rotations, solver
from ha2g_jax.motion.armature import Animation, carriers, export_axes, ha2g_armature, world
from ha2g_jax.motion.formats import bvh
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.readers import read_motion
from ha2g_jax.motion.readers.body import FACE
from ha2g_jax.motion.rigs import RIGS, load_rig, places, retarget
from ha2g_jax.skeleton import load_skeleton

UNITS = {"centimetres": 0.01, "metres": 1.0, "inches": 0.0254, "millimetres": 0.001, "CMU": 0.05644, "feet": 0.3048}
FOUND = ("centimetres", "metres", "inches", "millimetres")  # by the length of the arms
TREES = (".bvh", ".glb", ".json", ".csv")


@pytest.fixture(scope="module")
def own(files) -> tuple[Motion, Animation]:
    """The motion that is written, and its animation."""
    motion = read_motion(files["own"])
    return motion, solver.animate(motion)


def check_joints(found: Motion, own: tuple[Motion, Animation], rig: str) -> None:
    """Compare all joints with those of the rig, from the chest, and where the head points."""
    written, animation = own[0], retarget(own[1], load_rig(rig))
    _, points = world(animation)
    ours = {joint: place for joint, place in places(animation.armature).items() if joint in found.joint_names}
    names = [joint for joint in ours if joint not in FACE or rig == "ha2g"]
    assert len(names) == (43 if rig == "ha2g" else 38)
    assert (found.num_frames, found.fps) == (written.num_frames, pytest.approx(written.fps))
    theirs = points[:, [ours[joint] for joint in names]] - points[:, ours["spine"]][:, None]
    kept = found.positions[:, [found.joint_names.index(joint) for joint in names]].astype(np.float64)
    np.testing.assert_allclose(theirs * export_axes(found.skeleton), kept, atol=1e-3)
    nose = found.skeleton.bone("nose")
    np.testing.assert_allclose(found.directions[:, nose], written.directions[:, nose], atol=1e-3)


def changed(content: bytes, suffix: str, unit: float, affix: str) -> bytes:
    """A file of ours in another unit and with other names of the joints."""
    if suffix in (".glb", ".vrma"):
        tree, blob = split_glb(content)
        for node in tree["nodes"]:
            node["name"] = affix.format(node["name"])
        tree["nodes"][0]["scale"] = [1 / unit] * 3
        return join_glb(tree, blob)
    text = content.decode()
    if suffix == ".bvh":
        text = re.sub(r"(ROOT|JOINT) (\S+)", lambda it: f"{it[1]} {affix.format(it[2])}", text)
        return rescaled(text, unit).encode()
    if suffix == ".csv":
        head, *rows = csv.reader(text.splitlines())
        is_place = [name.endswith(("_x", "_y", "_z")) for name in head]
        rows = [[str(float(it) / unit) if scaled else it for it, scaled in zip(row, is_place)] for row in rows]
        return "\n".join(",".join(row) for row in [head, *rows]).encode()
    table = json.loads(text)
    for joint in table["joints"]:
        joint |= {"name": affix.format(joint["name"]), "offset": [it / unit for it in joint["offset"]]}
    for frame in table["frames"]:
        frame["positions"] = [[it / unit for it in place] for place in frame["positions"]]
    return json.dumps(table).encode()


def rescaled(text: str, unit: float) -> str:
    """A BVH of centimetres in another unit: offsets, and the place of the root."""

    def scaled(line: str, start: int) -> str:
        words = line.split()
        places = [f"{float(word) * 0.01 / unit:.9f}" for word in words[start : start + 3]]
        return " ".join([*words[:start], *places, *words[start + 3 :]])

    head, rest = text.split("MOTION\n")
    bones = [scaled(line, 1) if "OFFSET" in line else line for line in head.splitlines()]
    count, time, *frames = rest.splitlines()
    return "\n".join([*bones, "MOTION", count, time, *(scaled(line, 0) for line in frames), ""])


@pytest.fixture(scope="module")
def written(own, tmp_path_factory) -> dict[tuple[str, str], bytes]:
    folder, (motion, _) = tmp_path_factory.mktemp("written"), own
    kinds = [*((rig, suffix) for rig in RIGS for suffix in TREES), ("vrm", ".vrma"), ("smplx", ".npz")]
    for rig, suffix in kinds:
        formats.export(motion, folder / f"{rig}{suffix}", rig=rig)
    return {(rig, suffix): (folder / f"{rig}{suffix}").read_bytes() for rig, suffix in kinds}


def test_every_rig_in_every_format(written, own, tmp_path):
    for (rig, suffix), content in written.items():
        path = tmp_path / f"x{suffix}"
        path.write_bytes(content)
        check_joints(read_motion(path), own, rig)
        assert rig != "vrm" or read_motion(path, source_fps=60).fps == 60


@settings(max_examples=12, deadline=None)
@given(
    rig=st.sampled_from(RIGS),
    suffix=st.sampled_from(TREES),
    unit=st.sampled_from(sorted(UNITS)),
    affix=st.sampled_from(["{}", "mixamorig1:{}", "Char01_{}", "Armature|{}", "{}_jnt"]),
)
def test_every_rig_in_every_unit_and_with_any_names(rig, suffix, unit, affix, written, own, tmp_path_factory):
    path = tmp_path_factory.mktemp("x") / f"x{suffix}"
    path.write_bytes(changed(written[rig, suffix], suffix, UNITS[unit], affix))
    found = read_motion(path, unit=None if unit in FOUND else UNITS[unit])
    assert found.meta["read_from"]["unit"] == UNITS[unit]
    check_joints(found, own, rig)


@pytest.mark.parametrize("rig", ["ha2g", "mixamo"])
def test_a_root_that_another_program_turned_to_z_up(rig, files, tmp_path):
    """The rest pose is that of our files, but the person would lie on the back if y were up."""
    own = read_motion(files["own"])
    animation = retarget(solver.animate(own), load_rig(rig))
    animation.rotations[:, 0] = rotations.multiply(
        rotations.about(np.array([1.0, 0, 0]), np.pi / 2), animation.rotations[:, 0]
    )
    bvh.write(tmp_path / "x.bvh", animation)
    found = read_motion(tmp_path / "x.bvh")
    assert found.meta["read_from"]["up"] == "z"
    assert np.sum(found.directions * own.directions, axis=-1).mean() > 0.95


@pytest.mark.parametrize("suffix", TREES)
def test_a_child_keeps_its_size(suffix, tmp_path):
    """Arms of 35 cm are as long in centimetres as those of an adult are in inches, nearly."""
    motion = swaying()
    child = dataclasses.replace(motion.skeleton, lengths=0.63 * motion.skeleton.lengths)
    own = Motion.from_directions(child, motion.directions, motion.fps)
    formats.export(own, tmp_path / f"x{suffix}")
    lengths = read_motion(tmp_path / f"x{suffix}").skeleton.lengths
    np.testing.assert_allclose(lengths, child.lengths, atol=0.002)


@pytest.mark.parametrize("name", ["ted_expressive", "ted_gesture"])
def test_a_face_that_moves_with_the_head_comes_back(name, tmp_path):
    skeleton = load_skeleton(name)
    armature = ha2g_armature(skeleton)
    still = [joint for joint in armature.joints if joint in FACE or "eye" in joint or "ear" in joint]
    vectors = np.linspace(0, 1, 8)[:, None, None] * np.random.default_rng(1).normal(0, 0.15, (len(armature.joints), 3))
    vectors[:, [armature.joint(joint) for joint in still if joint != carriers(skeleton)[skeleton.bone("nose")]]] = 0
    turned = Animation(armature, rotations.from_vector(vectors), np.zeros((8, 3)), 15.0, {})
    motion = Motion.from_directions(skeleton, solver.directions_of(turned, skeleton), 15)
    kinds = [("mixamo", ".bvh"), ("unreal", ".glb"), ("vrm", ".vrma"), ("smplx", ".npz"), ("ha2g", ".csv")]
    for rig, suffix in kinds:
        formats.export(motion, tmp_path / f"x{suffix}", rig=rig)
        found = read_motion(tmp_path / f"x{suffix}", skeleton=name)
        face = [skeleton.joint(joint) for joint in FACE if joint in skeleton.joints]
        there, here = (it.positions[:, face] - it.positions[:, [skeleton.joint("neck")]] for it in (motion, found))
        np.testing.assert_allclose(there, here, atol=1e-3, err_msg=rig)


@pytest.mark.parametrize("skeleton", ["ted_expressive", "ted_gesture"])
def test_legs_and_place_come_back(skeleton, files, tmp_path):
    written = read_motion(files["BEAT2"], skeleton=skeleton)
    for rig, suffix in (("ha2g", ".glb"), ("mixamo", ".bvh"), ("unreal", ".csv")):
        formats.export(written, tmp_path / f"x{suffix}", rig=rig)
        found = read_motion(tmp_path / f"x{suffix}", skeleton=skeleton)
        assert written.lower and found.lower
        floor = [0, written.lower.floor, 0]
        np.testing.assert_allclose(found.lower.translation + floor, written.lower.translation, atol=1e-3)
        if rig != "unreal":  # legs of the table's own length
            np.testing.assert_allclose(found.lower.positions() + floor, written.lower.positions(), atol=1e-3)


def as_spreadsheet(text: str, separator: str, point: str = ".", quote: str = "") -> str:
    """A table as a spreadsheet saves it."""
    rows = [[f"{quote}{value.replace('.', point)}{quote}" for value in row.split(",")] for row in text.splitlines()]
    return "\n".join(separator.join(row) for row in rows)


@pytest.mark.parametrize("form", [(";", ","), (";",), ("\t", ","), (",", ".", '"')])
def test_a_table_that_a_spreadsheet_saved_is_the_same_motion(form, tmp_path):
    formats.export(swaying(frames=9, fps=30), tmp_path / "x.csv")
    written = read_motion(tmp_path / "x.csv")
    (tmp_path / "x.csv").write_text(as_spreadsheet((tmp_path / "x.csv").read_text(), *form))
    found = read_motion(tmp_path / "x.csv")
    np.testing.assert_array_equal(found.positions, written.positions)
    assert found.fps == written.fps == 30


def test_a_table_in_another_form_is_not_taken_for_another_format(tmp_path):
    formats.export(swaying(frames=9), tmp_path / "x.csv")
    text = (tmp_path / "x.csv").read_text()
    for content in (text.encode("utf-16"), text.replace(",", "|").encode(), b"words\n"):
        (tmp_path / "x.csv").write_bytes(content)
        with pytest.raises(UserError, match=r"x\.csv is not a table of ha2g export: its first line .* frame,time,"):
            read_motion(tmp_path / "x.csv")


def test_a_table_that_lacks_frames_is_refused(tmp_path):
    formats.export(swaying(frames=60, fps=30), tmp_path / "x.csv")
    lines = (tmp_path / "x.csv").read_text().splitlines()
    (tmp_path / "x.csv").write_text("\n".join(lines[:21] + lines[41:]))  # without frames 20 to 39
    with pytest.raises(UserError, match=r"x\.csv: its times have a gap at row 22, 0\.7 s after .* not 0\.0333 s"):
        read_motion(tmp_path / "x.csv")
    assert read_motion(tmp_path / "x.csv", source_fps=30).num_frames == 40
