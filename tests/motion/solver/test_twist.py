"""A twist follows its observations, is held without them, and does not jump at any direction of the bone."""

import numpy as np
import pytest
from fixtures.motions import swaying

from ha2g_jax.motion import rigs, rotations, solver
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.rigs import Transfer, retarget
from ha2g_jax.motion.solver.twist import continue_angle, smooth_angle, transport

X = np.array([1.0, 0.0, 0.0])


@pytest.mark.parametrize("fps", [15, 60])
def test_what_is_seen_well_is_followed_through_whole_turns(fps):
    time = np.arange(4 * fps) / fps
    angle = 2.5 * np.pi * np.sin(2 * time)
    found = smooth_angle(np.exp(1j * angle), fps)
    np.testing.assert_allclose(found, angle, atol=0.05)
    assert np.ptp(found) > 2 * np.pi


@pytest.mark.parametrize("fps", [15, 60])
def test_where_nothing_is_seen_the_twist_is_interpolated(fps):
    observations = np.exp(1j * np.concatenate([np.full(fps, 0.2), np.zeros(fps), np.full(fps, 1.2)]))
    observations[fps : 2 * fps] = 0
    found = smooth_angle(observations, fps)
    np.testing.assert_allclose(found[: fps // 2], 0.2, atol=0.01)
    np.testing.assert_allclose(found[-fps // 2 :], 1.2, atol=0.01)
    np.testing.assert_allclose(np.diff(found[fps:-fps]), 1 / (fps + 1), atol=0.2 / fps)


def test_a_weak_observation_against_all_others_is_overruled():
    observations = np.ones(31, complex)
    observations[10:20] = -1e-5
    np.testing.assert_allclose(smooth_angle(observations, 15), 0, atol=0.1)


@pytest.mark.parametrize("count", [1, 2])
def test_nothing_seen_at_all_is_no_twist(count):
    np.testing.assert_array_equal(smooth_angle(np.zeros(count, complex), 15), 0)


def test_a_transported_bone_does_not_jump_where_it_points_back():
    angle = np.linspace(0, 2 * np.pi, 200)
    along = np.stack([np.cos(angle), np.sin(angle), 0.01 * (1 - np.cos(angle))], axis=-1)
    along = rotations.unit(along)
    still = np.tile(rotations.IDENTITY, (200, 1))
    frames = transport(still, X, along)
    np.testing.assert_allclose(rotations.rotate(frames, X), along, atol=1e-12)
    assert rotations.angle_between(frames[1:], frames[:-1]).max() < 0.05
    shortest = rotations.between(X, along)
    assert rotations.angle_between(shortest[1:], shortest[:-1]).max() > 0.5


def test_a_transported_bone_moves_with_its_parent():
    above = rotations.about(np.array([0.0, 1.0, 0.0]), np.linspace(0, 2, 50))
    along = rotations.rotate(above, rotations.unit(np.array([1.0, 1.0, 0.0])))
    local = rotations.multiply(rotations.conjugate(above), transport(above, X, along))
    np.testing.assert_allclose(rotations.angle_between(local, local[:1]), 0, atol=1e-7)


FPS, FRAMES = 15, 60


@pytest.fixture(scope="module", params=["ted_expressive", "ted_gesture"])
def motion(request):
    return swaying(request.param, FRAMES, FPS, size=0.4)


def convert(motion, sizes):
    live = solver.Solver(motion.skeleton, motion.fps)
    ends = np.cumsum(sizes)
    return np.concatenate([live.animate(part).rotations for part in np.split(motion.directions, ends)[: len(sizes)]])


@pytest.fixture(scope="module")
def one_by_one(motion):
    """The rotations of frames that arrive one at a time."""
    return convert(motion, [1] * FRAMES)


def test_a_frame_is_the_last_frame_of_a_motion_that_ends_with_it(motion, one_by_one):
    for frames in (1, 2, 17, FRAMES):
        short = Motion.from_directions(motion.skeleton, motion.directions[:frames], FPS)
        expected = solver.animate(short).rotations[-1]
        # Half turns of early frames that are hardly seen may be decided differently, and are forgotten.
        assert rotations.angle_between(one_by_one[frames - 1], expected).max() < 1e-3


def test_the_rotations_do_not_depend_on_how_many_frames_arrive_at_once(motion, one_by_one):
    np.testing.assert_allclose(convert(motion, [FRAMES]), one_by_one, atol=1e-9)
    np.testing.assert_allclose(convert(motion, [7, 1, 30, 22]), one_by_one, atol=1e-9)


def test_the_twists_are_close_to_those_with_all_frames_known(motion, one_by_one):
    later = solver.animate(motion).rotations
    assert np.quantile(rotations.angle_between(one_by_one, later), 0.9) < np.deg2rad(10)


def test_signs_of_the_quaternions_are_continuous(motion):
    live, rig = solver.Solver(motion.skeleton, FPS), rigs.load_rig("unity")
    transfer, before, own, found = Transfer.between(live.armature, rig), None, [], []
    for frame in motion.directions:
        own.append(live.animate(frame[None]))
        before = transfer.apply(own[-1], before).rotations[-1]
        found.append(before)
    assert (np.sum(np.array(found[1:]) * np.array(found[:-1]), axis=-1) > 0).all()
    assert rotations.angle_between(retarget(own[-1], rig).rotations[-1], found[-1]).max() < 1e-9


@pytest.mark.parametrize("weight", [1.0, 2e-5])
def test_an_angle_is_the_last_one_of_the_fit_to_all_observations_so_far(weight):
    random = np.random.default_rng(0)
    angle = np.cumsum(random.normal(0, 0.3, 50))
    observations = weight * random.uniform(0, 1, 50) * np.exp(1j * angle)
    known = None
    for count, observation in enumerate(observations, 1):
        known = continue_angle(complex(observation), FPS, known)
        expected = smooth_angle(observations[:count], FPS)[-1]
        assert abs(np.exp(1j * known.angle) - np.exp(1j * expected)) < 1e-6
