"""The noise is a function of the seed and the frame's number, normal at each moment and smooth in time."""

import numpy as np
import pytest

from ha2g_jax.features.noise import track


def test_a_frame_has_the_same_noise_in_every_window():
    whole = track(7, np.arange(-40, 200), 15, 6)
    windows = track(7, np.array([-40, 3, 100])[:, None] + np.arange(34), 15, 6)
    for start, window in zip((-40, 3, 100), windows, strict=True):
        np.testing.assert_array_equal(window, whole[40 + start : 74 + start])
    np.testing.assert_allclose(track(7, np.arange(0, 400, 2), 30, 6), whole[40:], atol=1e-5)  # in seconds, not frames
    assert track(7, np.arange(34), 15, 0).shape == (34, 0)


def test_the_numbers_are_those_of_other_runtimes():
    """The page computes the same, see integrations/web/test/noise.test.ts."""
    expected = [[0.5156042, 0.23819974], [-0.90501124, 2.7902267], [-1.7358935, -0.07637546]]
    np.testing.assert_allclose(track(3, np.array([-4, 96, 296]), 15, 2), expected, atol=1e-6)
    np.testing.assert_allclose(track(2**32 - 1, np.array([1]), 15, 3)[0], [0.18276846, 1.235434, 0.07706467], atol=1e-6)


def test_each_moment_is_normal_and_independent_of_other_seeds_channels_and_far_moments():
    values = track(np.arange(4000), np.arange(100, 200), 15, 4).astype(np.float64)  # (seeds, frames, channels)
    assert np.abs(values.mean(axis=0)).max() < 0.1 and np.abs(values.var(axis=0) - 1).max() < 0.15
    assert np.mean(np.abs(values) < 1) == pytest.approx(0.6827, abs=0.01)
    flat = values[:, [0, 4, 8, 15, 60]].reshape(4000, -1)
    correlation = np.corrcoef(flat.T).reshape(5, 4, 5, 4)
    np.testing.assert_allclose(correlation[..., [0, 4], :][0, :, 1], np.zeros((4, 4)), atol=0.08)  # 4 s apart
    same = correlation[np.arange(5), :, np.arange(5)]
    np.testing.assert_allclose(same, np.broadcast_to(np.eye(4), (5, 4, 4)), atol=0.08)
    slow, fast = correlation[0, 0, :, 0], correlation[0, 3, :, 3]
    assert slow[1] > 0.85 and fast[2] < 0.4  # a quarter and half of a second apart
    assert np.abs(np.diff(values, axis=1)).max() < 1.6
