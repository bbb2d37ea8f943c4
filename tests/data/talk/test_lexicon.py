"""The classes of gesture-bearing words and their hand shapes."""

import itertools

import numpy as np

from ha2g_jax import skeleton as skeletons
from ha2g_jax.data.talk import anatomy, lexicon


def test_every_class_has_words_a_shape_and_a_path():
    words = list(itertools.chain(*lexicon.WORD_CLASSES.values()))
    assert len(words) == len(set(words))
    assert lexicon.WORD_CLASSES.keys() == lexicon.HAND_SHAPES.keys() == lexicon.ARM_PATHS.keys()
    assert lexicon.word_class("Tiny") == "small"
    assert lexicon.word_class("table") == ""


def test_hand_shapes_are_told_apart_by_the_fingers_alone():
    for first, second in itertools.combinations(lexicon.HAND_SHAPES.values(), 2):
        assert np.linalg.norm(np.subtract(first, second)) > 0.6


def test_flexions_are_read_back_from_a_drawn_hand():
    skeleton = skeletons.load_skeleton("ted_expressive")
    shapes = np.array(list(lexicon.HAND_SHAPES.values()))
    fingers = np.stack([shapes, shapes[::-1]], axis=1)
    trunk, head, shrug = (np.zeros((len(shapes), size)) for size in (3, 3, 2))
    body = anatomy.Body(trunk, head, shrug, np.full((len(shapes), 2, 7), 20.0), fingers)
    read = anatomy.finger_flexions(skeleton, anatomy.body_directions(skeleton, body))
    np.testing.assert_allclose(read, fingers, atol=1e-6)


def test_inverse_kinematics_reaches_every_path():
    skeleton = skeletons.load_skeleton("ted_expressive")
    for path in lexicon.ARM_PATHS.values():
        arms = np.zeros((1, 2, 7))
        arms[..., :4] = anatomy.reach(skeleton, path.peak, swivel=20)
        body = anatomy.Body(np.zeros((1, 3)), np.zeros((1, 3)), np.zeros((1, 2)), arms, np.zeros((1, 2, 5)))
        assert all(np.allclose(a, b) for a, b in zip(body, anatomy.within_limits(body), strict=True))
        pose = skeletons.directions_to_positions(skeleton, anatomy.body_directions(skeleton, body))[0]
        for side, sign in (("left", 1), ("right", -1)):
            offset = pose[skeleton.joint(f"{side}_wrist")] - pose[skeleton.joint(f"{side}_shoulder")]
            np.testing.assert_allclose(offset * (sign, -1, -1), path.peak, atol=1e-5)
