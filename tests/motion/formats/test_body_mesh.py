"""The body is closed, smooth, moved by joints near it, and the same on both sides."""

import numpy as np
import pytest
from PIL import Image, ImageDraw

from ha2g_jax.figure import DEFAULT_LOOK, draw_figure, fit
from ha2g_jax.figure.shapes import backdrop, project
from ha2g_jax.motion.armature import export_axes, figure_armature, rest_positions
from ha2g_jax.motion.formats.body_mesh import COLOURS, body_mesh
from ha2g_jax.motion.rigs import RIGS
from ha2g_jax.skeleton import load_skeleton


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


def test_whole_legs_are_drawn_where_the_rig_has_them(animate):
    assert "shoes" not in body_mesh(animate().armature)
    assert {"trousers", "shoes"} <= set(body_mesh(animate(rig="vrm").armature))


@pytest.mark.parametrize("name", ["ted_expressive", "ted_gesture"])
def test_the_body_is_the_person_of_the_videos(name):
    """In the T-pose both cover the same pixels, and most of these in the same colour."""
    skeleton, size = load_skeleton(name), 480
    armature = figure_armature(skeleton)
    _, places = rest_positions(armature)
    positions = places[[armature.joint(joint) for joint in skeleton.joints]] * export_axes(skeleton)
    view = fit([(positions[None], skeleton)])
    flat = draw_figure(positions, skeleton, DEFAULT_LOOK, size, size, view).astype(int)
    scale, spine = view.place(size, size)
    solid = Image.new("RGB", (size, size), DEFAULT_LOOK.background)
    corners, colours = [], []
    for colour, part in body_mesh(armature).items():
        corners.append((part.points * [1, -1, -1])[part.faces])
        colours += [COLOURS[colour][0]] * len(part.faces)
    triangles = np.concatenate(corners)
    for index in np.argsort(-triangles[..., 2].mean(axis=1)):  # from back to front
        place = project(triangles[index]) * scale + spine
        ImageDraw.Draw(solid).polygon(place.ravel().tolist(), fill=colours[index])
    seen = np.asarray(solid).astype(int)
    empty = backdrop(DEFAULT_LOOK.background, size, size), Image.new("RGB", (size, size), DEFAULT_LOOK.background)
    bodies = [np.abs(each - np.asarray(none)).max(axis=-1) > 20 for each, none in zip((flat, seen), empty, strict=True)]
    assert (bodies[0] & bodies[1]).sum() > 0.92 * (bodies[0] | bodies[1]).sum()
    both = bodies[0] & bodies[1]
    assert (np.abs(flat - seen)[both].max(axis=-1) < 30).mean() > 0.85
