"""Frames converted as they arrive do not wait for later ones, and are those of a motion that ends with them."""

import numpy as np
import pytest

from ha2g_jax.motion import rigs, rotations, solver
from ha2g_jax.motion.motion import Motion
from ha2g_jax.motion.rigs import Transfer, retarget
from ha2g_jax.motion.solver.twist import continue_angle, smooth_angle
from ha2g_jax.skeleton import load_skeleton

FPS, FRAMES = 15, 60


@pytest.fixture(scope="module", params=["ted_expressive", "ted_gesture"])
def motion(request):
    """Bones that wander about their mean directions."""
    skeleton = load_skeleton(request.param)
    time = np.arange(FRAMES)[:, None, None] / FPS
    random = np.random.default_rng(0)
    phase, speed = random.uniform(0, 6, (2, 1, skeleton.num_bones, 3))
    directions = skeleton.mean_directions + 0.4 * np.sin(phase + speed * time)
    return Motion.from_directions(skeleton, directions, FPS)


def convert(motion, sizes):
    live = solver.Solver(motion.skeleton, motion.fps)
    ends = np.cumsum(sizes)
    return np.concatenate([live.animate(part).rotations for part in np.split(motion.directions, ends)[: len(sizes)]])


def test_a_frame_is_the_last_frame_of_a_motion_that_ends_with_it(motion):
    found = convert(motion, [1] * FRAMES)
    for frames in (1, 2, 17, FRAMES):
        short = Motion.from_directions(motion.skeleton, motion.directions[:frames], FPS)
        expected = solver.animate(short).rotations[-1]
        # Half turns of early frames that are hardly seen may be decided differently, and are forgotten.
        assert rotations.angle_between(found[frames - 1], expected).max() < 1e-3


def test_the_rotations_do_not_depend_on_how_many_frames_arrive_at_once(motion):
    np.testing.assert_allclose(convert(motion, [FRAMES]), convert(motion, [1] * FRAMES), atol=1e-9)
    np.testing.assert_allclose(convert(motion, [7, 1, 30, 22]), convert(motion, [1] * FRAMES), atol=1e-9)


def test_the_twists_are_close_to_those_with_all_frames_known(motion):
    later = solver.animate(motion).rotations
    assert np.quantile(rotations.angle_between(convert(motion, [1] * FRAMES), later), 0.9) < np.deg2rad(10)


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
