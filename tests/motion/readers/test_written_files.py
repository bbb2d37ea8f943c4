"""What the package writes it reads: each rig, in each unit and with any names, at the joints of the file."""

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from motion.readers.test_kinds import rigid

from ha2g_jax.motion import formats, solver
from ha2g_jax.motion.armature import world
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.readers import read_motion
from ha2g_jax.motion.rigs import RIGS, load_rig, places, retarget

UNITS = {"centimetres": 0.01, "metres": 1.0, "inches": 0.0254, "millimetres": 0.001, "CMU": 0.05644, "feet": 0.3048}
FACE = ("nose", "head", "left_eye", "right_eye", "left_ear", "right_ear")  # of our own rig only


def check_joints(found: Motion, written: Motion, rig: str) -> None:
    """Compare arms and hands with those of the rig, from the chest, after the one rotation of the recording."""
    animation = retarget(solver.animate(written), load_rig(rig))
    _, points = world(animation)
    ours = {joint: place for joint, place in places(animation.armature).items() if joint in found.joint_names}
    names = [joint for joint in ours if joint not in FACE or rig == "ha2g"]
    assert (
        len(names) == (43 if rig == "ha2g" else 38)
        and found.num_frames == written.num_frames
        and found.fps == pytest.approx(written.fps)
    )
    theirs = points[:, [ours[joint] for joint in names]] - points[:, ours["spine"]][:, None]
    kept = found.positions[:, [found.joint_names.index(joint) for joint in names]].astype(np.float64)
    np.testing.assert_allclose(theirs @ rigid(theirs, kept), kept, atol=1e-3)


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
def bvhs(files, tmp_path_factory) -> dict[str, str]:
    folder = tmp_path_factory.mktemp("bvh")
    for rig in RIGS:
        formats.export(read_motion(files["own"]), folder / f"{rig}.bvh", rig=rig)
    return {rig: (folder / f"{rig}.bvh").read_text() for rig in RIGS}


@settings(max_examples=30, deadline=None)
@given(
    rig=st.sampled_from(RIGS),
    unit=st.sampled_from(sorted(UNITS)),
    affix=st.sampled_from(["{}", "mixamorig1:{}", "Char01_{}", "Armature|{}", "{}_jnt"]),
)
def test_every_rig_in_every_unit_and_with_any_names(rig, unit, affix, bvhs, files, tmp_path_factory):
    path = tmp_path_factory.mktemp("x") / "x.bvh"
    text = re.sub(r"(ROOT|JOINT) (\S+)", lambda it: f"{it[1]} {affix.format(it[2])}", bvhs[rig])
    path.write_text(rescaled(text, UNITS[unit]))
    found = read_motion(path, unit=UNITS[unit] if unit in ("CMU", "feet") else None)
    assert found.meta["read_from"]["unit"] == UNITS[unit]
    check_joints(found, read_motion(files["own"]), rig)


@pytest.mark.parametrize(("rig", "suffix"), [*((rig, ".json") for rig in RIGS), ("smplx", ".npz")])
def test_tables_and_poses_of_every_rig(rig, suffix, files, tmp_path):
    written = read_motion(files["own"])
    formats.export(written, tmp_path / f"x{suffix}", rig=rig)
    check_joints(read_motion(tmp_path / f"x{suffix}"), written, rig)
    assert read_motion(tmp_path / f"x{suffix}", source_fps=60).fps == 60
