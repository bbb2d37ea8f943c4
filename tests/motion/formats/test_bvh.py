"""The BVH that other programs read has our joints at our places, in centimetres, y up, facing +z."""

import numpy as np
import pytest
from fixtures.bvh_readers import bvhio_places, pybvh_places

from ha2g_jax.motion.armature import world
from ha2g_jax.motion.formats import bvh
from ha2g_jax.motion.readers.bvh_motion import read_motion
from ha2g_jax.motion.rigs import RIGS
from ha2g_jax.skeleton import load_skeleton

MILLIMETRE = 1e-3


def check_joints(path, animation, places) -> None:
    """Compare the joints in the frames that `places` reads with ours."""
    bvh.write(path, animation)
    _, positions = world(animation)
    found = places(path)
    assert set(found) == set(animation.armature.joints) and min(map(len, found.values())) >= 10
    for index, name in enumerate(animation.armature.joints):
        np.testing.assert_allclose(found[name], positions[: len(found[name]), index], atol=MILLIMETRE, err_msg=name)


@pytest.mark.parametrize("rig", RIGS)
@pytest.mark.parametrize("places", [bvhio_places, pybvh_places])
def test_other_readers_find_the_joints_where_they_are(animate, tmp_path, places, rig):
    check_joints(tmp_path / "m.bvh", animate(rig=rig), places)


def test_the_rest_pose_is_all_zeros_and_a_T(animate, tmp_path):
    """The left hand lies at +x, the head above, the nose ahead: y up, facing +z, in centimetres."""
    bvh.write(tmp_path / "m.bvh", animate())
    read = pytest.importorskip("pybvh").read_bvh_file(str(tmp_path / "m.bvh"))
    places = dict(zip([node.name for node in read.nodes], read.rest_pose_positions()))
    assert places["left_wrist"][0] > 80
    assert places["right_wrist"][0] < -80
    assert places["neck"][1] == pytest.approx(26, abs=0.01)
    assert places["nose"][2] > 10
    np.testing.assert_allclose(places["left_middle_3"][1:], places["left_elbow"][1:], atol=1e-4)


@pytest.mark.parametrize("rig", ["ha2g", "mixamo"])
def test_our_own_importer_reads_it(animate, tmp_path, rig):
    animation = animate(rig=rig)
    bvh.write(tmp_path / "m.bvh", animation)
    skeleton = load_skeleton("ted_expressive")
    found = read_motion(tmp_path / "m.bvh", skeleton, fps=animation.fps).positions
    _, positions = world(animation)
    elbow, wrist = (skeleton.joint(f"left_{joint}") for joint in ("elbow", "wrist"))
    names = ("left_elbow", "left_wrist") if rig == "ha2g" else ("mixamorig:LeftForeArm", "mixamorig:LeftHand")
    ours = np.subtract(*(positions[:, animation.armature.joint(name)] for name in names))
    # Upright stays upright, and which way the person faces on average is the importer's choice.
    np.testing.assert_allclose(-(found[:, elbow] - found[:, wrist])[:, 1], ours[:, 1], atol=MILLIMETRE)


def test_angles_do_not_jump_by_whole_turns(animate, tmp_path):
    """A program that interpolates between frames would spin the joint."""
    bvh.write(tmp_path / "m.bvh", animate(frames=60))
    lines = (tmp_path / "m.bvh").read_text().splitlines()
    rows = np.array([line.split() for line in lines[lines.index("Frames: 60") + 2 :]], float)
    assert np.abs(np.diff(rows[:, 3:], axis=0)).max() < 180
