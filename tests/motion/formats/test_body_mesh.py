"""The body is closed, smooth, moved by joints near it, and the same on both sides."""

import numpy as np
import pytest

from ha2g_jax.motion.formats.body_mesh import COLOURS, body_mesh
from ha2g_jax.motion.rigs import RIGS, places, rest_positions


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


def test_left_and_right_are_alike(animate):
    points = body_mesh(animate().armature)["skin"].points
    mirrored = points * [-1, 1, 1]
    distances = np.linalg.norm(points[:, None] - mirrored[None, ::7], axis=-1).min(axis=0)
    assert distances.max() < 0.004


def test_legs_are_drawn_where_the_rig_has_them(animate):
    assert "trousers" not in body_mesh(animate().armature)
    assert {"trousers", "shoes"} <= set(body_mesh(animate(rig="vrm").armature))


def test_every_finger_has_a_skin_and_ted_gesture_a_hand(animate):
    """A finger's tip is near the skin; without fingers the hand still reaches past the wrist."""
    armature = animate().armature
    skin = body_mesh(armature)["skin"].points
    _, positions = rest_positions(armature)
    for finger in ("thumb", "index", "middle", "ring", "pinky"):
        tip = positions[places(armature)[f"right_{finger}_3"]]
        assert np.linalg.norm(skin - tip, axis=1).min() < 0.015
    plain = animate("ted_gesture").armature
    _, positions = rest_positions(plain)
    wrist = positions[places(plain)["left_wrist"]]
    assert body_mesh(plain)["skin"].points[:, 0].max() > wrist[0] + 0.12
