"""Rests of joints are found where they are, and score by their distance to onsets, in BEAT2 too."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import argrelmin
from scipy.spatial.transform import Rotation

from ha2g_jax.metrics.beats import rests
from ha2g_jax.metrics.beats.rests import EDGE, FPS, UPPER_BODY, beat_consistency, mean_speeds
from ha2g_jax.skeleton import load_skeleton


def pulsing(fps: float, stops: np.ndarray, seconds: float = 4.0) -> np.ndarray:
    """(T, 1, 3) on a line whose speed 1 + |t - rest| m/s is least, but not 0, at `stops`, times of frames."""
    time = (np.arange(round(seconds * fps)) - 0.5) / fps  # of the step that leads to each frame
    speeds = 1 + np.abs(time[:, None] - stops[None]).min(axis=1)
    return np.cumsum(speeds)[:, None, None] / fps * np.array([[[1.0, 0, 0]]])


def test_the_joints_are_those_of_the_body():
    expressive, gesture = (load_skeleton(name) for name in ("ted_expressive", "ted_gesture"))
    body = [expressive.joints[joint] for joint in rests.upper_body(expressive)]
    assert len(set(body)) == 13
    assert not any(part in name for name in body for part in ("index", "middle", "ring", "pinky", "thumb"))
    arms = {gesture.joints[joint] for joint in rests.upper_body(gesture)}
    assert arms == {f"{side}_{part}" for side in ("left", "right") for part in ("shoulder", "elbow", "wrist")}


def test_speeds_are_central_differences():
    positions = np.zeros((4, 1, 3))
    positions[:, 0, 1] = [0, 1, 4, 9]
    np.testing.assert_allclose(rests.joint_speeds(positions, 2)[:, 0], [2, 4, 8, 10])
    np.testing.assert_allclose(rests.mean_speeds([positions, positions[:1]], 2), [6])


@settings(max_examples=50, deadline=None)
@given(st.lists(st.integers(0, 9), min_size=2, max_size=60), st.integers(1, 7))
def test_rests_are_scipys_relative_minima_above_the_threshold(values, num_frames):
    speeds = np.array(values, float)
    expected = [i for i in argrelmin(speeds, order=num_frames)[0] if speeds[i] > 2.5]
    np.testing.assert_array_equal(rests.rests(speeds, num_frames, 2.5), expected)


@pytest.mark.parametrize("fps", [15, 30])
@pytest.mark.parametrize("first_frame", [0, 4, 9])
def test_a_rest_is_indexed_in_the_motion_whatever_is_cropped(fps, first_frame):
    stops = np.array([1.0, 2.2, 3.2])
    positions = pulsing(fps, stops)
    score = rests.beat_align(positions, stops, np.ones(1), fps, first_frame=first_frame, sigma=0.05)
    assert score == pytest.approx(1)
    late = rests.beat_align(positions, stops + 0.3, np.ones(1), fps, first_frame=first_frame, sigma=0.05)
    assert late < 0.01


def test_the_kernel_by_hand():
    positions = np.concatenate([pulsing(15, np.array([2.0])), np.zeros((60, 1, 3))], axis=1)
    (frame,) = rests.rests(rests.joint_speeds(positions[:, :1], 15)[:, 0], 3)
    onsets = np.array([0.2, frame / 15, frame / 15 + 0.3, 4.5])  # the first in the seed, the last past the end
    expected = (1 + np.exp(-0.5)) / 2
    assert rests.beat_align(positions[:, :1], onsets, np.ones(1), 15) == pytest.approx(expected)
    # A joint without a rest scores 0 where the data set moves it, and is left out where nothing ever does.
    assert rests.beat_align(positions, onsets, np.array([1.0, 1]), 15) == pytest.approx(expected / 2)
    assert rests.beat_align(positions, onsets, np.array([1.0, 0]), 15) == pytest.approx(expected)


def test_a_pause_below_the_relative_threshold_is_no_rest():
    positions, onsets = pulsing(15, np.array([2.0])), np.array([2.0])
    assert rests.beat_align(positions, onsets, np.array([3.0]), 15) > 0.9
    assert rests.beat_align(positions, onsets, np.array([4.0]), 15) == 0
    assert rests.beat_align(positions, onsets, np.array([4.0]), 15, threshold=0.1) > 0.9


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_turning_and_moving_the_body_change_nothing(seed):
    rng = np.random.default_rng(seed)
    positions = np.cumsum(rng.normal(0, 0.02, (60, 4, 3)), axis=0)
    onsets, speeds = rng.uniform(0, 4, 6), rests.mean_speeds([positions], 15)
    moved = positions @ Rotation.from_rotvec(rng.normal(size=3)).as_matrix().T + rng.normal(size=3)
    expected = rests.beat_align(positions, onsets, speeds, 15)
    assert 0 <= expected <= 1
    assert rests.beat_align(moved, onsets, speeds, 15) == pytest.approx(expected)


def test_what_stands_still_scores_nothing_and_what_cannot_be_scored_is_undefined():
    still, onsets = np.ones((60, 2, 3), np.float32), np.array([1.0, 2.0])
    assert rests.beat_align(still, onsets, np.ones(2), 15) == 0
    assert rests.beat_align(still, onsets, np.zeros(2), 15) == 0
    assert np.isnan(rests.beat_align(still, np.zeros(0), np.ones(2), 15))
    for frames in (0, 4, 5):
        assert np.isnan(rests.beat_align(still[:frames], np.array([0.3]), np.ones(2), 15))
    np.testing.assert_array_equal(rests.mean_speeds([still[:1]], 15), 0)


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
    found = beat_consistency(joints, onsets, mean_speeds([joints], FPS))
    assert found == pytest.approx(np.exp(-(delay**2) / (2 * 0.3**2)), abs=0.03)


def test_the_ends_are_not_scored():
    onsets = np.array([0.5, 1.5, 19.0])  # within 2 s of an end of 20 s
    joints = stopping(onsets)
    assert EDGE / FPS == 2
    assert np.isnan(beat_consistency(joints, onsets, mean_speeds([joints], FPS)))
