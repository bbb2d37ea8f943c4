"""Interpolation stays on the sphere, keeps what it is given, moves at an even speed and shows no knots."""

import numpy as np
import pytest

from ha2g_jax.motion.resample import exp_map, log_map, resample, sample, slerp


def unit_vectors(*shape: int, seed: int = 0) -> np.ndarray:
    vectors = np.random.default_rng(seed).normal(size=(*shape, 3)).astype(np.float32)
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


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
    rotating = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)[:, None].astype(np.float32)
    finer = resample(rotating, 15, 24, 23)[:, 0]
    steps = np.arccos(np.clip(np.sum(finer[1:] * finer[:-1], axis=-1), -1, 1))
    np.testing.assert_allclose(steps, 0.2 * 15 / 24, atol=1e-3)


def sway(seed: int = 0) -> np.ndarray:
    """Smooth movement of 5 bones at 15 frames a second."""
    rng = np.random.default_rng(seed)
    time = np.arange(300)[:, None, None] / 15
    offsets = np.sin(2 * np.pi * rng.uniform(0.3, 2, (1, 5, 3)) * time + rng.uniform(0, 6, (1, 5, 3)))
    vectors = unit_vectors(5) + 0.3 * offsets
    return (vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)).astype(np.float32)


def test_acceleration_shows_no_comb():
    """Straight lines between frames put all acceleration into every fourth frame of 60 a second."""

    def comb(directions: np.ndarray) -> float:
        size = np.linalg.norm(np.diff(directions.astype(np.float64), n=2, axis=0), axis=-1).mean(axis=-1)
        phases = size[8 : 8 + (len(size) - 16) // 4 * 4].reshape(-1, 4).mean(axis=0)
        return phases.max() / phases.min()

    motion = sway()
    places = np.arange(4 * 299) / 4
    rows = places.astype(int)
    straight = slerp(motion[rows], motion[rows + 1], (places - rows)[:, None, None])
    assert comb(resample(motion, 15, 60, 4 * 299)) < 2
    assert comb(straight) > 5


def test_a_curve_is_nearer_to_the_truth_than_lines():
    fine, every_second = sway(), sway()[::2]
    rows = np.arange(len(every_second) - 1)
    lines = slerp(every_second[rows], every_second[rows + 1], np.array([0.5]))
    truth = fine[1:-1:2]
    assert np.abs(sample(every_second, rows + 0.5) - truth).mean() < 0.5 * np.abs(lines - truth).mean()


def test_a_long_motion_is_as_its_pieces():
    motion, places = sway(), np.linspace(-1, 300, 9000)
    pieces = [sample(motion, places[start : start + 1000]) for start in range(0, 9000, 1000)]
    np.testing.assert_array_equal(sample(motion, places), np.concatenate(pieces))


@pytest.mark.parametrize("frames", [1, 2, 3])
def test_the_shortest_motions_are_resampled(frames):
    motion = sway()[:frames]
    finer = resample(motion, 15, 60, 4 * frames)
    np.testing.assert_allclose(finer[::4], motion, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(finer, axis=-1), 1, atol=1e-6)


def test_the_log_map_is_the_turn_to_a_vector():
    tangent = log_map(np.array([1.0, 0, 0]), np.array([np.cos(0.7), 0, np.sin(0.7)]))
    np.testing.assert_allclose(tangent, [0, 0, 0.7], atol=1e-12)
    np.testing.assert_allclose(exp_map(np.array([1.0, 0, 0]), tangent), [np.cos(0.7), 0, np.sin(0.7)], atol=1e-12)
    np.testing.assert_array_equal(log_map(np.array([1.0, 0, 0]), np.array([-1.0, 0, 0])), 0)
