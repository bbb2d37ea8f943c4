"""Geometry of the skeletons: what every other module takes from the one table."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ha2g_jax import skeleton as skeletons


@pytest.fixture(params=skeletons.SKELETONS)
def skeleton(request):
    return skeletons.load_skeleton(request.param)


def random_directions(skeleton, seed, shape=()):
    vectors = np.random.default_rng(seed).normal(size=(*shape, skeleton.num_bones, 3))
    return skeletons.normalize(vectors.astype(np.float32))


def test_sizes_are_those_of_the_paper():
    expressive, gesture = (skeletons.load_skeleton(name) for name in skeletons.SKELETONS)
    assert (expressive.num_joints, expressive.pose_dim) == (43, 126)
    assert tuple(map(len, expressive.level_channels)) == (24, 30, 36, 66, 96, 126)
    assert (gesture.num_joints, gesture.pose_dim) == (10, 27)
    assert tuple(map(len, gesture.level_channels)) == (15, 21, 27)


def test_levels_are_nested(skeleton):
    for level in range(1, skeleton.num_levels):
        assert set(skeleton.level_channels[level - 1]) < set(skeleton.level_channels[level])


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), name=st.sampled_from(skeletons.SKELETONS))
def test_directions_survive_the_way_to_positions_and_back(seed, name):
    skeleton = skeletons.load_skeleton(name)
    directions = random_directions(skeleton, seed, (3,))
    positions = skeletons.directions_to_positions(skeleton, directions)
    np.testing.assert_allclose(skeletons.positions_to_directions(skeleton, positions), directions, atol=1e-5)
    parents, children = np.array(skeleton.bones).T
    lengths = np.linalg.norm(positions[:, children] - positions[:, parents], axis=-1)
    np.testing.assert_allclose(lengths, np.broadcast_to(skeleton.lengths, lengths.shape), rtol=1e-4)


@pytest.mark.parametrize("xp", [np, jnp])
def test_directions_of_whole_numbers_are_those_of_floating_ones(xp, skeleton):
    directions = np.random.default_rng(0).integers(-2, 3, (4, skeleton.num_bones, 3))
    directions[0, 0] = 0
    expected = skeletons.directions_to_positions(skeleton, directions.astype(np.float64))
    found = skeletons.directions_to_positions(skeleton, xp.asarray(directions))
    np.testing.assert_allclose(found, expected, atol=1e-5)


@pytest.mark.parametrize("kind", ["float32", "bfloat16"])
def test_vectors_keep_their_type_when_they_are_scaled(kind):
    assert skeletons.normalize(jnp.ones((2, 3), kind)).dtype == kind


def test_angle_between_known_bones():
    skeleton = skeletons.load_skeleton("ted_gesture")
    directions = np.tile(np.array([1.0, 0.0, 0.0]), (skeleton.num_bones, 1))
    _, second = skeleton.angle_pairs[0]
    directions[second] = [0.0, 2.0, 0.0]
    assert skeletons.joint_angles(skeleton, directions)[0] == pytest.approx(np.pi / 2)


def test_angle_gradient_is_finite_at_parallel_and_zero_bones(skeleton):
    for value in (1.0, 0.0):
        directions = jnp.full((skeleton.num_bones, 3), value)
        gradient = jax.grad(lambda d: skeletons.joint_angles(skeleton, d).sum())(directions)
        assert jnp.isfinite(gradient).all()


def test_numpy_and_jax_agree(skeleton):
    directions = random_directions(skeleton, 2, (4,))
    for function in (skeletons.directions_to_positions, skeletons.joint_angles, skeletons.mirror_directions):
        ours, theirs = function(skeleton, directions), function(skeleton, jnp.asarray(directions))
        assert isinstance(ours, np.ndarray)
        np.testing.assert_allclose(ours, theirs, atol=1e-5)
