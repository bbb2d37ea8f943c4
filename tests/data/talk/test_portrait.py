"""Portraits show the style."""

import numpy as np
import pytest

from ha2g_jax import skeleton as skeletons
from ha2g_jax.data.talk import speakers

POSE = skeletons.load_skeleton("ted_expressive").mean_pose


def test_portrait_is_a_picture_of_a_fixed_look():
    image = speakers.portrait(POSE, speakers.Style())
    assert image.shape == (224, 224, 3)
    assert image.dtype == np.uint8
    assert (image == speakers.portrait(POSE, speakers.Style())).all()


@pytest.mark.parametrize("field", speakers.Style._fields)
def test_every_number_of_the_style_is_visible_at_64_pixels(field):
    low, high = (speakers.portrait(POSE, speakers.Style(**{field: value}), 64).astype(int) for value in (-1.0, 1.0))
    assert np.abs(high - low).mean() > 1.5
