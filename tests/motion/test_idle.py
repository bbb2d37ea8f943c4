"""A resting figure breathes and sways like a person who waits, and never the same way again."""

import numpy as np
import pytest

from ha2g_jax.metrics.beats.strokes import stroke_beats, wrist_positions
from ha2g_jax.motion.control import rest_pose
from ha2g_jax.motion.idle import idle, shifts
from ha2g_jax.motion.rotations import from_vector, rotate
from ha2g_jax.skeleton import SKELETONS, load_skeleton

FPS, TEN_MINUTES = 15, np.arange(9000)


@pytest.mark.parametrize("name", SKELETONS)
def test_hands_and_head_move_a_little_and_slowly(name):
    skeleton = load_skeleton(name)
    pose = rest_pose(skeleton)
    for directions in (idle(skeleton, pose, seed, TEN_MINUTES, FPS) for seed in range(3)):
        np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1, atol=1e-6)
        wrists = wrist_positions(skeleton, directions)
        assert np.linalg.norm(np.diff(wrists, axis=0), axis=-1).max() * FPS < 0.04
        assert 0.005 < np.linalg.norm(wrists.std(axis=0), axis=-1).min() < 0.02
        assert np.linalg.norm(wrists - wrist_positions(skeleton, pose[None]), axis=-1).max() < 0.05
        heads = directions[:, skeleton.bone("nose")]
        assert 0.5 < np.rad2deg(np.linalg.norm(heads.std(axis=0))) < 4


def test_shoulders_breathe_about_fifteen_times_a_minute():
    skeleton = load_skeleton("ted_expressive")
    height = idle(skeleton, rest_pose(skeleton), 0, TEN_MINUTES, FPS)[:, skeleton.bone("left_shoulder"), 1]
    power = np.abs(np.fft.rfft(height - height.mean())) ** 2
    frequencies = np.fft.rfftfreq(len(height), 1 / FPS)
    is_breath = (frequencies > 0.15) & (frequencies < 0.4)
    assert power[is_breath].sum() > 0.3 * power.sum()


def test_a_frame_is_the_same_in_every_window_and_other_seeds_differ():
    skeleton = load_skeleton("ted_expressive")
    pose = rest_pose(skeleton)
    whole = idle(skeleton, pose, 3, np.arange(-20, 300), FPS)
    np.testing.assert_array_equal(idle(skeleton, pose, 3, np.arange(100, 134), FPS), whole[120:154])
    assert np.abs(idle(skeleton, pose, 4, np.arange(-20, 300), FPS) - whole).max() > 0.02


def test_no_ten_seconds_of_ten_minutes_repeat():
    """The nearest other ten seconds are at least a third of the usual distance from the mean pose away."""
    skeleton = load_skeleton("ted_expressive")
    wrists = wrist_positions(skeleton, idle(skeleton, rest_pose(skeleton), 0, TEN_MINUTES, FPS)).reshape(9000, 6)
    wrists -= wrists.mean(axis=0)
    segments = np.lib.stride_tricks.sliding_window_view(wrists, 150, axis=0)[::5].reshape(-1, 900)
    squares = np.sum(segments**2, axis=1)
    distances = np.sqrt(np.maximum(squares[:, None] + squares - 2 * segments @ segments.T, 0) / 150)
    numbers = np.arange(len(segments))
    is_apart = np.abs(numbers[:, None] - numbers) >= 30
    assert distances[is_apart].min() > np.sqrt(np.mean(squares) / 150) / 3


def test_two_minutes_with_shifts_are_never_near_to_two_others_and_still_rest():
    skeleton = load_skeleton("ted_expressive")
    pose = idle(skeleton, rest_pose(skeleton), 0, TEN_MINUTES, FPS)
    wrists = wrist_positions(skeleton, rotate(from_vector(shifts(skeleton, 0, TEN_MINUTES, FPS)), pose))
    assert FPS * np.linalg.norm(np.diff(wrists, axis=0), axis=-1).mean() < 0.05 and not len(stroke_beats(wrists, FPS))
    for lag in range(1800, 7200, 75):
        sums = np.cumsum(np.linalg.norm(wrists[lag:] - wrists[:-lag], axis=-1).mean(axis=-1))
        assert (sums[1800:] - sums[:-1800]).min() / 1800 > 0.03
