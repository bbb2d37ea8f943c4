"""Every pose of a motion is inside its images."""

import numpy as np
import pytest
from figure.poses import POSES, WIDE, posed

from ha2g_jax import figure
from ha2g_jax import skeleton as skeletons
from ha2g_jax.figure import from_the_front
from ha2g_jax.figure.face import head_frame, head_shapes
from ha2g_jax.figure.limbs import hand_parts
from ha2g_jax.figure.shapes import project


@pytest.mark.parametrize("length", [1.0, 1.6])
@pytest.mark.parametrize("name", skeletons.SKELETONS)
def test_the_view_contains_the_figure_at_any_amplitude(name, length):
    skeleton = skeletons.load_skeleton(name)
    random = np.random.default_rng(2).normal(size=(60, skeleton.num_bones, 3))
    for strength in (0.2, 1.0, 100.0):
        directions = skeleton.mean_directions + strength * random
        clip = length * skeletons.directions_to_positions(skeleton, directions)
        view = figure.fit([(clip, skeleton)])
        points = from_the_front(clip, skeleton)
        hands = [hand_parts(points, side, figure.DEFAULT_LOOK, 1) for side in ("left", "right")]
        drawn = [shape.outline for parts in hands for part in parts for shape in part.shapes]
        drawn += [shape.outline for shape in head_shapes(points, head_frame(points), figure.DEFAULT_LOOK, 1)]
        drawn.append(project(np.stack(list(points.values()), axis=1)))
        for width, height in ((720, 720), (640, 360), (300, 500)):
            scale, spine = view.place(width, height)
            places = np.concatenate(drawn, axis=1) * scale + spine
            assert (places > 0.02 * scale).all()
            assert (places < np.array([width, height]) - 0.02 * scale).all()


def test_a_view_is_never_smaller_than_the_default_and_that_of_two_motions_contains_both():
    skeleton = skeletons.load_skeleton("ted_expressive")
    calm, wide, high = (posed(skeleton, bones)[None] for bones in ({}, WIDE, POSES["up"]))
    assert figure.fit([(calm, skeleton)]) == figure.fit([]) == figure.DEFAULT_VIEW
    alone = [np.array(figure.fit([(clip, skeleton)])) for clip in (wide, high)]
    both = np.array(figure.fit([(wide, skeleton), (high, skeleton)]))
    np.testing.assert_array_equal(both[:2], np.minimum(*alone)[:2])
    np.testing.assert_array_equal(both[2:], np.maximum(*alone)[2:])
    assert both[0] < -0.9 and both[1] < -0.9 and both[2] > 0.9
