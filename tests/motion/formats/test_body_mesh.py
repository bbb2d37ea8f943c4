"""The body is closed, smooth, moved by joints near it, and the same on both sides."""

import numpy as np
import pytest

from ha2g_jax.motion.formats.body_mesh import COLOURS, body_mesh
from ha2g_jax.motion.rigs import RIGS


@pytest.mark.parametrize("rig", RIGS)
@pytest.mark.parametrize("skeleton", ["ted_expressive", "ted_gesture"])
def test_surfaces_are_closed_and_their_normals_point_out(animate, skeleton, rig):
    for colour, surface in body_mesh(animate(skeleton, rig=rig).armature).items():
        assert colour in COLOURS
        assert len(surface.points) < 65536  # faces are written with two bytes
        np.testing.assert_allclose(np.linalg.norm(surface.normals, axis=1), 1, atol=1e-6)
        edges = np.sort(surface.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        _, counts = np.unique(edges, axis=0, return_counts=True)
        assert (counts == 2).all()
        # The volume that the faces enclose is positive when they all look outwards.
        a, b, c = surface.points[surface.faces].transpose(1, 0, 2)
        assert (np.cross(a, b) * c).sum() > 0


@pytest.mark.parametrize("rig", RIGS)
def test_weights_of_joints_sum_to_1(animate, rig):
    for surface in body_mesh(animate(rig=rig).armature).values():
        joints, weights = surface.bindings
        np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-6)
        assert (weights >= 0).all()
        assert (joints[weights == 0] == 0).all()


def test_legs_are_drawn_where_the_rig_has_them(animate):
    assert "trousers" not in body_mesh(animate().armature)
    assert {"trousers", "shoes"} <= set(body_mesh(animate(rig="vrm").armature))
