"""The BVH that other programs read has our joints at our places, in centimetres, y up, facing +z."""

import numpy as np
import pytest

from ha2g_jax.motion.armature import world
from ha2g_jax.motion.formats import bvh
from ha2g_jax.motion.readers.bvh_motion import read_motion
from ha2g_jax.motion.rigs import RIGS
from ha2g_jax.skeleton import load_skeleton

MILLIMETRE = 1e-3


def differences(animation, found: dict[str, np.ndarray], frames) -> dict[str, float]:
    _, positions = world(animation)
    assert set(found) == set(animation.armature.joints)
    return {
        name: float(np.abs(found[name] - positions[frames, index]).max())
        for index, name in enumerate(animation.armature.joints)
    }


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


@pytest.mark.parametrize("rig", RIGS)
def test_bvhio_finds_the_joints_where_they_are(animate, tmp_path, rig):
    bvhio = pytest.importorskip("bvhio")
    animation = animate(rig=rig)
    bvh.write(tmp_path / "m.bvh", animation)
    root = bvhio.readAsHierarchy(str(tmp_path / "m.bvh"))
    frames, found = [0, 5, 11], {}
    for frame in frames:
        root.loadPose(frame)
        for joint, *_ in root.layout():
            found.setdefault(joint.Name, []).append([value / 100 for value in joint.PositionWorld])
    found = {name: np.array(places) for name, places in found.items()}
    assert max(differences(animation, found, frames).values()) < MILLIMETRE


def test_pybvh_finds_the_joints_where_they_are(animate, tmp_path):
    pybvh = pytest.importorskip("pybvh")
    animation = animate()
    bvh.write(tmp_path / "m.bvh", animation)
    read = pybvh.read_bvh_file(str(tmp_path / "m.bvh"))
    assert read.frame_time == pytest.approx(1 / 15, abs=1e-9)
    _, positions = world(animation)
    places = read.node_positions() if hasattr(read, "node_positions") else pybvh.frames_to_node_positions(read)
    names = [node.name for node in read.nodes]
    for index, name in enumerate(animation.armature.joints):
        np.testing.assert_allclose(places[:, names.index(name)] / 100, positions[:, index], atol=MILLIMETRE)


@pytest.mark.parametrize(
    ("skeleton", "rig"), [("ted_expressive", "ha2g"), ("ted_gesture", "ha2g"), ("ted_expressive", "unreal")]
)
def test_blender_finds_the_joints_where_they_are(animate, tmp_path, blender, skeleton, rig):
    animation = animate(skeleton, rig=rig)
    bvh.write(tmp_path / "m.bvh", animation)
    frames = list(range(10))
    assert max(differences(animation, blender(tmp_path / "m.bvh", frames), frames).values()) < MILLIMETRE


def test_the_rest_pose_is_all_zeros_and_a_T(animate, tmp_path):
    """The left hand lies at +x, the head above, the nose ahead: y up, facing +z, in centimetres."""
    bvh.write(tmp_path / "m.bvh", animate())
    places, stack, name = {}, [np.zeros(3)], ""
    for line in (tmp_path / "m.bvh").read_text().splitlines():
        words = line.split()
        if words[0] in ("ROOT", "JOINT", "End"):
            name = words[1]
        elif words[0] == "OFFSET":
            places[name] = stack[-1] + np.array(words[1:], float)
            stack.append(places[name])
        elif words[0] == "}":
            stack.pop()
        elif words[0] == "MOTION":
            break
    assert places["left_wrist"][0] > 80
    assert places["right_wrist"][0] < -80
    assert places["neck"][1] == pytest.approx(26, abs=0.01)
    assert places["nose"][2] > 10
    np.testing.assert_allclose(places["left_middle_3"][1:], places["left_elbow"][1:], atol=1e-4)


def test_the_same_animation_gives_the_same_bytes_and_every_frame(animate, tmp_path):
    animation = animate(frames=7)
    for name in ("a.bvh", "b.bvh"):
        bvh.write(tmp_path / name, animation)
    assert (tmp_path / "a.bvh").read_bytes() == (tmp_path / "b.bvh").read_bytes()
    lines = (tmp_path / "a.bvh").read_text().splitlines()
    start = lines.index("Frames: 7")
    assert lines[start + 1] == "Frame Time: 0.0666666667"
    rows = [[float(word) for word in line.split()] for line in lines[start + 2 :]]
    assert np.array(rows).shape == (7, 3 + 3 * len(animation.armature.joints))


def test_angles_do_not_jump_by_whole_turns(animate, tmp_path):
    """A program that interpolates between frames would spin the joint."""
    bvh.write(tmp_path / "m.bvh", animate(frames=60))
    lines = (tmp_path / "m.bvh").read_text().splitlines()
    rows = np.array([line.split() for line in lines[lines.index("Frames: 60") + 2 :]], float)
    assert np.abs(np.diff(rows[:, 3:], axis=0)).max() < 180
