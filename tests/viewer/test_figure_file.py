"""The figure for web pages rests in the T-pose, has the bone lengths of the model, and a body to move."""

import dataclasses
import json
import struct

import numpy as np

from ha2g_jax.motion.formats.gltf import write_figure
from ha2g_jax.skeleton import load_skeleton


def test_the_figure_rests_with_the_bone_lengths_of_the_model(tmp_path):
    skeleton = load_skeleton("ted_expressive")
    skeleton = dataclasses.replace(skeleton, lengths=1.25 * skeleton.lengths)
    write_figure(tmp_path / "figure.glb", skeleton)
    data = (tmp_path / "figure.glb").read_bytes()
    (size,) = struct.unpack("<I", data[12:16])
    tree = json.loads(data[20 : 20 + size])
    nodes = {node["name"]: node for node in tree["nodes"]}
    forearm = [skeleton.lengths[skeleton.bone("left_wrist")], 0, 0]  # along x in the T-pose
    np.testing.assert_allclose(nodes["left_wrist"]["translation"], forearm, atol=1e-6)
    assert all(node.get("rotation", [0, 0, 0, 1]) == [0, 0, 0, 1] for node in nodes.values())
    assert len(tree["skins"][0]["joints"]) == len(nodes) - 2  # all but the node of the rig and that of the body
    times = tree["animations"][0]["samplers"][0]["input"]
    assert tree["accessors"][times]["count"] == 1
