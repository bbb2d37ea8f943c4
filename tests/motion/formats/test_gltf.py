"""GLB and VRMA read by other programs are as the solver says, and the validator has no complaint."""

import dataclasses

import numpy as np
import pytest
from fixtures.glb_reader import GlbReader
from fixtures.motions import swaying
from scipy.spatial.transform import Rotation

from ha2g_jax.motion.armature import world
from ha2g_jax.motion.formats import export, gltf
from ha2g_jax.motion.formats.gltf import write_figure
from ha2g_jax.motion.lower_body import LowerBody
from ha2g_jax.motion.rigs import RIGS, places
from ha2g_jax.skeleton import load_skeleton

MILLIMETRE = 1e-3


@pytest.mark.parametrize("rig", RIGS)
def test_joints_are_where_we_say_at_ten_times(animate, tmp_path, rig):
    animation = animate(rig=rig)
    gltf.write_glb(tmp_path / "m.glb", animation)
    reader = GlbReader(tmp_path / "m.glb")
    _, positions = world(animation)
    names = [node.get("name") for node in reader.tree["nodes"]]
    for frame in range(10):
        matrices = reader.matrices(frame)
        found = np.array([matrices[names.index(name)][:3, 3] for name in animation.armature.joints])
        np.testing.assert_allclose(found, positions[frame], atol=MILLIMETRE / 10)
    times = reader.array(reader.tree["animations"][0]["samplers"][0]["input"])
    np.testing.assert_allclose(times[:, 0], np.arange(12) / 15, atol=1e-6)


@pytest.mark.parametrize("frames", [1, 12])
@pytest.mark.parametrize("rig", RIGS)
@pytest.mark.parametrize("skeleton", ["ted_expressive", "ted_gesture"])
def test_the_khronos_validator_finds_nothing(animate, tmp_path, validator, skeleton, rig, frames):
    animation = animate(skeleton, frames, rig)
    gltf.write_glb(tmp_path / "m.glb", animation)
    if rig == "vrm":
        gltf.write_vrma(tmp_path / "m.vrma", animation)
    for path in tmp_path.iterdir():
        issues = validator(path)["issues"]
        assert (issues["numErrors"], issues["numWarnings"]) == (0, 0), issues["messages"][:5]


@pytest.mark.parametrize("rig", ["ha2g", "unreal"])
def test_blender_finds_the_joints_where_they_are(animate, tmp_path, blender, rig):
    animation = animate(rig=rig)
    gltf.write_glb(tmp_path / "m.glb", animation)
    frames = list(range(10))
    found = blender(tmp_path / "m.glb", frames)
    _, positions = world(animation)
    for index, name in enumerate(animation.armature.joints):
        np.testing.assert_allclose(found[name], positions[frames, index], atol=MILLIMETRE)


@pytest.mark.parametrize("rig", RIGS)
def test_the_skin_fits_at_rest_and_follows_the_joints(animate, tmp_path, rig):
    """At rest the skin is the mesh itself; in motion fingers stay on their bones, and nothing is torn off."""
    animation = animate(rig=rig)
    gltf.write_glb(tmp_path / "m.glb", animation)
    reader = GlbReader(tmp_path / "m.glb")
    still = reader.skinned(None)
    for part in reader.tree["meshes"][0]["primitives"]:
        name = reader.tree["materials"][part["material"]]["name"]
        np.testing.assert_allclose(still[name], reader.array(part["attributes"]["POSITION"]), atol=1e-5)
    _, positions = world(animation)
    where = places(animation.armature)
    moved = reader.skinned(7)
    for side in ("left", "right"):
        for finger in ("thumb_2", "index_2", "pinky_2") if f"{side}_index_1" in where else ():
            joint = positions[7, where[f"{side}_{finger}"]]
            assert 0.002 < np.linalg.norm(moved["skin"] - joint, axis=1).min() < 0.02
        elbow = positions[7, where[f"{side}_elbow"]]
        assert 0.01 < np.linalg.norm(moved["shirt"] - elbow, axis=1).min() < 0.06


def test_a_vrma_has_bones_that_rest_unturned_and_no_mesh(animate, tmp_path):
    gltf.write_vrma(tmp_path / "m.vrma", animate(rig="vrm"))
    tree = GlbReader(tmp_path / "m.vrma").tree
    extension = tree["extensions"]["VRMC_vrm_animation"]
    assert tree["extensionsUsed"] == ["VRMC_vrm_animation"]
    assert extension["specVersion"] == "1.0"
    bones = extension["humanoid"]["humanBones"]
    assert {"hips", "upperChest", "leftThumbMetacarpal", "rightLittleDistal"} <= set(bones)
    assert not {"leftEye", "rightEye"} & set(bones)  # the format forbids them
    assert all(tree["nodes"][bone["node"]]["name"] == name for name, bone in bones.items())
    for node in tree["nodes"]:
        np.testing.assert_allclose(node.get("rotation", [0, 0, 0, 1]), [0, 0, 0, 1], atol=1e-9)
    assert {channel["target"]["path"] for channel in tree["animations"][0]["channels"]} == {"rotation"}
    assert "meshes" not in tree


def test_a_person_who_sits_stands_at_rest(tmp_path):
    """Players of VRM scale the movement of the hips by their height at rest."""
    motion = swaying(frames=10)
    thigh, shin, foot = [0, -0.45, 0], [0, -0.42, 0], [0, -0.06, 0.12]
    legs = np.array([[0, 0, 0], [0.1, 0, 0], thigh, shin, foot])
    legs = np.concatenate([legs, legs[1:] * [-1, 1, 1], [[0, 0.2, 0]]])
    turns = np.tile([0.0, 0, 0, 1], (10, 9, 1))
    turns[:, [1, 5]] = Rotation.from_euler("x", -90, degrees=True).as_quat()  # thighs lie level
    place = np.tile([3, 0.42 + 0.06 + 0.02, 1], (10, 1))
    place[:, 0] += np.linspace(0, 0.1, 10)
    sitting = dataclasses.replace(motion, lower=LowerBody(legs, turns, place))
    for rig, root, foot in (("vrm", "hips", "leftToes"), ("ha2g", "pelvis", "left_foot"), ("unreal", "root", "ball_l")):
        export(sitting, tmp_path / "m.glb", rig=rig)
        reader = GlbReader(tmp_path / "m.glb")
        names = [node.get("name") for node in reader.tree["nodes"]]
        rest, first = reader.matrices(None), reader.matrices(0)
        assert rest[names.index(foot)][1, 3] == pytest.approx(0.02, abs=1e-3)  # above the floor
        moved = first[names.index(root)][:3, 3] - rest[names.index(root)][:3, 3]
        np.testing.assert_allclose(moved, [3, -0.45, 1], atol=0.15)  # Unreal's legs have lengths of their own


def test_the_figure_rests_with_the_bone_lengths_of_the_model(tmp_path):
    skeleton = load_skeleton("ted_expressive")
    skeleton = dataclasses.replace(skeleton, lengths=1.25 * skeleton.lengths)
    write_figure(tmp_path / "figure.glb", skeleton)
    tree = GlbReader(tmp_path / "figure.glb").tree
    nodes = {node["name"]: node for node in tree["nodes"]}
    forearm = [skeleton.lengths[skeleton.bone("left_wrist")], 0, 0]  # along x in the T-pose
    np.testing.assert_allclose(nodes["left_wrist"]["translation"], forearm, atol=1e-6)
    assert all(node.get("rotation", [0, 0, 0, 1]) == [0, 0, 0, 1] for node in nodes.values())
    assert len(tree["skins"][0]["joints"]) == len(nodes) - 2  # all but the node of the rig and that of the body
    times = tree["animations"][0]["samplers"][0]["input"]
    assert tree["accessors"][times]["count"] == 1
