"""Drawing of a pose."""

import numpy as np
import pytest

from ha2g_jax import figure
from ha2g_jax import skeleton as skeletons


@pytest.mark.parametrize("name", skeletons.SKELETONS)
def test_draws_a_person_on_a_background(name):
    skeleton = skeletons.load_skeleton(name)
    picture = figure.draw_figure(skeleton.mean_pose, skeleton, figure.DEFAULT_LOOK, 160, 120)
    assert picture.shape == (120, 160, 3)
    assert picture.dtype == np.uint8
    shirt = np.abs(picture.astype(int) - figure.DEFAULT_LOOK.shirt).sum(axis=-1) < 30
    assert 0.05 < shirt.mean() < 0.5
    # Antialiased: many more colours than shapes.
    assert len(np.unique(picture[20:100, 40:120].reshape(-1, 3), axis=0)) > 100


def test_left_of_the_person_is_right_in_the_picture():
    skeleton = skeletons.load_skeleton("ted_expressive")
    pose = skeleton.mean_pose.copy()
    left_arm = [index for index, joint in enumerate(skeleton.joints) if joint.startswith("left_") and index > 3]
    hands_down = figure.draw_figure(pose, skeleton, figure.DEFAULT_LOOK, 120, 120).astype(int)
    pose[[index for index in left_arm if skeleton.joints[index] not in ("left_eye", "left_ear")], 1] -= 0.15
    changed = np.abs(figure.draw_figure(pose, skeleton, figure.DEFAULT_LOOK, 120, 120) - hands_down).sum(axis=-1) > 40
    assert changed[:, 60:].sum() > 5 * changed[:, :55].sum()


def test_place_in_the_room_does_not_matter():
    skeleton = skeletons.load_skeleton("ted_expressive")
    pictures = [
        figure.draw_figure(skeleton.mean_pose + shift, skeleton, figure.DEFAULT_LOOK, 64, 64).astype(int)
        for shift in (0.0, 3.0)
    ]
    assert np.abs(pictures[0] - pictures[1]).mean() < 0.1
