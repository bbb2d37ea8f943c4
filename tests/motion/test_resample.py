"""Interpolation stays on the sphere, keeps what it is given and moves at an even speed."""

import numpy as np
import pytest

from ha2g_jax.motion.resample import num_frames, resample, slerp


def unit_vectors(*shape: int, seed: int = 0) -> np.ndarray:
    vectors = np.random.default_rng(seed).normal(size=(*shape, 3)).astype(np.float32)
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


@pytest.mark.parametrize(("duration", "fps", "frames"), [(8, 15, 120), (2.27, 15, 34), (0.2, 15, 3), (0.2, 1, 1)])
def test_number_of_frames(duration, fps, frames):
    assert num_frames(duration, fps) == frames


def test_slerp_turns_by_the_fraction_of_the_angle():
    first, second = unit_vectors(100), unit_vectors(100, seed=1)
    angle = np.arccos(np.sum(first * second, axis=-1))
    for fraction in (0, 0.25, 0.5, 1):
        mixed = slerp(first, second, np.full((100, 1), fraction, np.float32))
        np.testing.assert_allclose(np.linalg.norm(mixed, axis=-1), 1, atol=1e-6)
        np.testing.assert_allclose(np.sum(mixed * first, axis=-1), np.cos(fraction * angle), atol=1e-5)
        np.testing.assert_allclose(np.sum(mixed * second, axis=-1), np.cos((1 - fraction) * angle), atol=1e-5)


@pytest.mark.parametrize("second", [[1, 0, 0], [1, 1e-5, 0], [-1, 0, 0], [-1, 1e-5, 0]])
@pytest.mark.parametrize("fraction", [0, 0.3, 0.7, 1])
def test_slerp_of_equal_and_opposite_vectors_is_a_unit_vector(second, fraction):
    mixed = slerp(np.array([1.0, 0, 0]), np.array(second), np.array([fraction]))
    assert np.linalg.norm(mixed) == pytest.approx(1)


def test_the_same_rate_gives_the_same_frames():
    directions = unit_vectors(20, 5)
    np.testing.assert_allclose(resample(directions, 15, 15, 20), directions, atol=1e-6)


def test_frames_that_both_rates_have_agree_and_the_end_is_held():
    directions = unit_vectors(20, 5)
    doubled = resample(directions, 15, 30, 40)
    assert doubled.shape == (40, 5, 3)
    assert doubled.dtype == np.float32
    np.testing.assert_allclose(doubled[::2], directions, atol=1e-6)
    np.testing.assert_allclose(doubled[-1], directions[-1], atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(doubled, axis=-1), 1, atol=1e-6)
    np.testing.assert_allclose(resample(directions, 15, 5, 7), directions[::3], atol=1e-6)


def test_a_steady_turn_stays_steady():
    angle = np.arange(15) * 0.2
    turn = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)[:, None].astype(np.float32)
    finer = resample(turn, 15, 24, 23)[:, 0]
    steps = np.arccos(np.clip(np.sum(finer[1:] * finer[:-1], axis=-1), -1, 1))
    np.testing.assert_allclose(steps, 0.2 * 15 / 24, atol=1e-3)
