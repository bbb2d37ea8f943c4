"""Windows cover the frames with none to spare, and join without a step."""

import numpy as np
import pytest

from ha2g_jax.motion.windows import join_windows, num_windows


@pytest.mark.parametrize(
    ("frames", "count"), [(1, 1), (30, 1), (34, 1), (35, 2), (64, 2), (65, 3), (120, 4), (450, 15), (900, 30)]
)
def test_number_of_windows(frames, count):
    assert num_windows(frames, 34, 4) == count


@pytest.mark.parametrize("frames", range(1, 200, 7))
def test_windows_cover_the_frames_and_no_window_is_idle(frames):
    count = num_windows(frames, 34, 4)
    assert 34 + 30 * (count - 1) >= frames
    assert count == 1 or 34 + 30 * (count - 2) < frames


def test_joining_cuts_of_one_motion_gives_it_back():
    angle = np.linspace(0, 6, 94)
    motion = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)[:, None].astype(np.float32)
    windows = np.stack([motion[start : start + 34] for start in (0, 30, 60)])
    np.testing.assert_allclose(join_windows(windows, 4), motion, atol=1e-6)


def test_one_window_is_itself():
    window = np.zeros((1, 34, 2, 3), np.float32)
    window[..., 0] = 1
    np.testing.assert_array_equal(join_windows(window, 4), window[0])


def test_the_fade_turns_in_fifths_and_stays_on_the_sphere():
    windows = np.zeros((2, 34, 1, 3), np.float32)
    windows[0, ..., 0] = windows[1, ..., 1] = 1  # x, then y
    joined = join_windows(windows, 4)
    assert joined.shape == (64, 1, 3)
    angles = np.degrees(np.arctan2(joined[:, 0, 1], joined[:, 0, 0]))
    np.testing.assert_allclose(angles[28:36], [0, 0, 18, 36, 54, 72, 90, 90], atol=1e-3)
    np.testing.assert_allclose(np.linalg.norm(joined, axis=-1), 1, atol=1e-6)


def test_a_disagreement_is_spread_over_the_fade():
    """Two windows that stand still at an angle: no step is larger than its share."""
    rest = np.random.default_rng(0).normal(size=(2, 1, 42, 3)).astype(np.float32)
    rest /= np.linalg.norm(rest, axis=-1, keepdims=True)
    joined = join_windows(np.repeat(rest, 34, axis=1), 4)
    whole = np.arccos(np.sum(rest[0, 0] * rest[1, 0], axis=-1))
    steps = np.arccos(np.clip(np.sum(joined[1:] * joined[:-1], axis=-1), -1, 1))
    assert (steps <= whole / 5 + 1e-3).all()
