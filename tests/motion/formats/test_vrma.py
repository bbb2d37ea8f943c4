"""A VRM animation names its bones as VRM does, rests in the VRM T-pose, and passes the validator."""

import json
import struct

import numpy as np

from ha2g_jax.motion.formats import gltf


def tree_of(path) -> dict:
    data = path.read_bytes()
    size = struct.unpack("<I", data[12:16])[0]
    return json.loads(data[20 : 20 + size])


def test_bones_are_nodes_of_the_same_name(animate, tmp_path):
    gltf.write_vrma(tmp_path / "m.vrma", animate(rig="vrm"), duration=0.8)
    tree = tree_of(tmp_path / "m.vrma")
    extension = tree["extensions"]["VRMC_vrm_animation"]
    assert tree["extensionsUsed"] == ["VRMC_vrm_animation"]
    assert extension["specVersion"] == "1.0"
    bones = extension["humanoid"]["humanBones"]
    assert {"hips", "upperChest", "leftThumbMetacarpal", "rightLittleDistal"} <= set(bones)
    assert not {"leftEye", "rightEye"} & set(bones)  # the format forbids them
    assert all(tree["nodes"][bone["node"]]["name"] == name for name, bone in bones.items())


def test_at_rest_no_node_is_turned_and_only_hips_may_travel(animate, tmp_path):
    gltf.write_vrma(tmp_path / "m.vrma", animate(rig="vrm"))
    tree = tree_of(tmp_path / "m.vrma")
    for node in tree["nodes"]:
        np.testing.assert_allclose(node.get("rotation", [0, 0, 0, 1]), [0, 0, 0, 1], atol=1e-9)
    assert {channel["target"]["path"] for channel in tree["animations"][0]["channels"]} == {"rotation"}
    assert "meshes" not in tree


def test_the_validator_has_no_complaint(animate, tmp_path, validator):
    gltf.write_vrma(tmp_path / "m.vrma", animate(rig="vrm"))
    issues = validator(tmp_path / "m.vrma")["issues"]
    assert (issues["numErrors"], issues["numWarnings"]) == (0, 0), issues["messages"]
