"""Smoothing takes jitter out, moves nothing in time, and keeps what is smooth."""

import numpy as np
import pytest

from ha2g_jax.errors import UserError
from ha2g_jax.motion.smoothing import slow_mean, smooth


def turning(frames: int, step: float = 0.1) -> np.ndarray:
    angle = np.arange(frames) * step
    return np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)[:, None].astype(np.float32)


@pytest.mark.parametrize("frames", [1, 2, 3, 4, 5, 9, 60])
@pytest.mark.parametrize("seconds", [0, 0.1, 0.2, 0.5, 2])
def test_a_steady_turn_stays_up_to_its_ends(frames, seconds):
    np.testing.assert_allclose(smooth(turning(frames), 15, seconds), turning(frames), atol=1e-6)


def test_nothing_to_do_gives_the_very_input():
    motion = turning(30)
    assert smooth(motion, 15, 0) is motion
    assert smooth(motion, 15, 2 / 15) is motion


def test_jitter_becomes_less_the_wider_the_window():
    noisy = turning(200) + np.random.default_rng(0).normal(0, 0.05, (200, 1, 3)).astype(np.float32)
    noisy /= np.linalg.norm(noisy, axis=-1, keepdims=True)
    jitter = [np.abs(smooth(noisy, 15, seconds) - turning(200)).mean() for seconds in (0, 0.2, 0.4, 1)]
    assert np.all(np.diff(jitter) < 0)
    assert jitter[-1] < 0.5 * jitter[0]


def test_a_stroke_stays_where_it_is_in_time():
    angle = np.exp(-0.5 * ((np.arange(60) - 25) / 2) ** 2)
    stroke = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)[:, None].astype(np.float32)
    smoothed = smooth(stroke, 15, 0.6)
    assert np.argmax(smoothed[:, 0, 1]) == 25
    np.testing.assert_allclose(smoothed[25 - 20 : 25], smoothed[25 + 20 : 25 : -1], atol=1e-6)  # as even as it was
    assert smoothed[25, 0, 1] < stroke[25, 0, 1] - 0.02


def test_the_weights_are_a_raised_cosine():
    """cos^2(pi / 3) = 1/4 at one frame of a window of three."""
    corner = np.zeros((7, 1, 3), np.float32)
    corner[:3, 0, 0] = corner[3:, 0, 1] = 1
    expected = np.array([0.25, 1.25]) / np.linalg.norm([0.25, 1.25])
    np.testing.assert_allclose(smooth(corner, 15, 0.2)[3, 0, :2], expected, atol=1e-6)


def test_opposite_directions_have_no_mean_and_stay():
    flipping = np.zeros((9, 1, 3), np.float32)
    flipping[:, 0, 0] = [1, -1, 1, -1, 1, -1, 1, -1, 1]
    smoothed = smooth(flipping, 1, 4 / 1.0 * 0.5)
    np.testing.assert_allclose(np.abs(smoothed[..., 0]), 1)


@pytest.mark.parametrize("seconds", [-0.1, 2.1, float("nan"), float("inf")])
def test_a_width_that_is_none_is_refused(seconds):
    with pytest.raises(UserError, match="expected 0 to 2"):
        smooth(turning(30), 15, seconds)


def test_no_frames_have_a_slow_mean_of_no_frames():
    assert slow_mean(np.zeros((0, 9, 4)), 15, 4).shape == (0, 9, 4)


def test_the_slow_mean_is_the_middle_of_a_sway():
    angle = 0.3 * np.sin(2 * np.pi * np.arange(300) / 15)
    sway = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)[:, None]
    np.testing.assert_allclose(slow_mean(sway, 15, 4), np.broadcast_to([1, 0, 0], sway.shape), atol=0.06)
