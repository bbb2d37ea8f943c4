"""The scores of BEAT2 have the values that follow from their definitions."""

import numpy as np
import pytest

from ha2g_jax.metrics.beats.rests import EDGE, FPS, UPPER_BODY, beat_consistency, mean_speeds
from ha2g_jax.metrics.kinematics import l1_diversity


def test_l1div_is_the_sum_over_coordinates_of_the_mean_distance_from_the_mean():
    joints = np.zeros((4, 55, 3))
    joints[:, 7, 1] = [0.0, 0.0, 2.0, 2.0]
    joints[:, 8, 0] = [1.0, -1.0, 1.0, -1.0]
    before = joints.copy()
    assert l1_diversity(joints, first_frame=0) == pytest.approx(2.0)
    np.testing.assert_array_equal(joints, before)
    assert l1_diversity(np.ones((4, 55, 3)), first_frame=0) == 0


def stopping(rests: np.ndarray, frames: int = 600) -> np.ndarray:
    """Joints that slow down at some seconds, but not to less than 0.4 of their mean speed."""
    times = np.arange(frames) / FPS
    speed = 1 - 0.6 * np.exp(-np.square(times[:, None] - rests) / (2 * 0.1**2)).sum(axis=1)
    path = np.cumsum(speed) / FPS
    return np.repeat(np.stack([path, 0 * path, 0 * path], axis=-1)[:, None], len(UPPER_BODY), axis=1)


@pytest.mark.parametrize("delay", [0.0, 0.3])
def test_bc_is_the_kernel_of_the_distance_to_the_nearest_rest(delay):
    onsets = np.arange(3.01, 17.0, 1.5)  # between frames, so that one of them is the slowest
    joints = stopping(onsets + delay)
    found = beat_consistency(joints, onsets, mean_speeds([joints], FPS, first_frame=0))
    assert found == pytest.approx(np.exp(-(delay**2) / (2 * 0.3**2)), abs=0.03)


def test_the_ends_are_not_scored():
    onsets = np.array([0.5, 1.5, 19.0])  # within 2 s of an end of 20 s
    joints = stopping(onsets)
    assert EDGE / FPS == 2
    assert np.isnan(beat_consistency(joints, onsets, mean_speeds([joints], FPS, first_frame=0)))
