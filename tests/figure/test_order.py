"""What is nearer is drawn over what is farther."""

import numpy as np
import pytest
from figure.poses import GREEN, is_background, posed

from ha2g_jax import figure
from ha2g_jax import skeleton as skeletons
from ha2g_jax.figure import arm_ranks, from_the_front
from ha2g_jax.figure.face import head_frame


def test_hands_are_behind_the_head_or_in_front_of_it():
    skeleton, size = skeletons.load_skeleton("ted_gesture"), 240
    heads, rows, columns = [], slice(0, 100), slice(90, 150)
    for depth in (0.45, -0.45):
        sides = {f"{side}_elbow": (sign, -0.8, depth) for side, sign in (("left", 1), ("right", -1))}
        sides |= {f"{side}_wrist": (-sign, -0.35, depth / 3) for side, sign in (("left", 1), ("right", -1))}
        heads.append(figure.draw_figure(posed(skeleton, sides), skeleton, GREEN, size, size)[rows, columns])
    down = figure.draw_figure(posed(skeleton, {}), skeleton, GREEN, size, size)[rows, columns]
    in_front = [(np.abs(head.astype(int) - down).sum(axis=-1) > 60)[~is_background(down)].mean() for head in heads]
    assert in_front[0] < 0.03 < 0.1 < in_front[1]


@pytest.mark.parametrize("near", ["left", "right"])
def test_the_arm_that_is_nearer_where_arms_cross_is_in_front(near):
    skeleton = skeletons.load_skeleton("ted_expressive")
    crossed = {}
    for side, sign in (("left", 1), ("right", -1)):
        crossed[f"{side}_elbow"] = (0.2 * sign, 0.9, -0.5 if side == near else -0.1)
        crossed[f"{side}_wrist"] = (-0.9 * sign, -0.4, -0.3)
    points = from_the_front(posed(skeleton, crossed)[None], skeleton)
    ranks = dict(zip(("left", "right"), arm_ranks(points, head_frame(points)[0]), strict=True))
    far = "right" if near == "left" else "left"
    assert ranks[near].lower > ranks[far].lower >= 0
    assert (ranks[near].upper >= 0).all()
