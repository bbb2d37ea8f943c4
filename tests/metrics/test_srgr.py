"""A joint is found or not, weighted by what the words mean."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ha2g_jax.metrics.srgr import srgr

REAL = np.random.default_rng(0).normal(size=(12, 3, 3))


def off(*moves: tuple[int, int, tuple[float, float, float]]) -> np.ndarray:
    generated = REAL.copy()
    for frame, joint, move in moves:
        generated[frame, joint] += move
    return generated


def test_without_weights_it_is_the_share_of_correct_keypoints():
    wrong = off((5, 0, (0.2, 0, 0)), (6, 1, (0, 0.2, 0)), (7, 2, (0, 0, 0.05)), (1, 0, (9, 9, 9)))
    assert srgr(wrong, REAL) == pytest.approx(1 - 2 / 24)  # 8 frames of 3 joints; the seed frame does not count
    assert srgr(wrong, REAL, first_frame=0) == pytest.approx(1 - 3 / 36)


def test_the_two_norms_differ_where_they_should():
    diagonal = off((5, 0, (0.05, 0.05, 0.05)))  # 0.15 by the first, 0.087 by the second
    assert srgr(diagonal, REAL, norm="l1") == pytest.approx(23 / 24)
    assert srgr(diagonal, REAL, norm="l2") == 1
    assert srgr(diagonal, REAL, norm="l1", delta=0.2) == 1


def test_frames_count_by_their_weight():
    weights = np.full(12, 0.1)
    weights[5] = 1.0
    weights[:4] = 77
    wrong = off(*((5, joint, (1, 0, 0)) for joint in range(3)))
    assert srgr(wrong, REAL, weights) == pytest.approx(0.7 / 1.7)
    assert srgr(REAL, REAL, weights) == pytest.approx(1)
    assert srgr(REAL, REAL, weights, mean_weight=0.165) == pytest.approx(1.7 / 8 / 0.165)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_moving_both_bodies_alike_changes_nothing_and_perfect_is_1(seed):
    rng = np.random.default_rng(seed)
    weights, shift = rng.uniform(0.01, 1, 12), rng.normal(size=3)
    other = REAL + rng.normal(0, 0.05, REAL.shape)
    assert srgr(REAL, REAL, weights) == pytest.approx(1)
    assert srgr(other + shift, REAL + shift, weights) == pytest.approx(srgr(other, REAL, weights))


def test_undefined_without_frames_or_meaning():
    assert np.isnan(srgr(REAL[:4], REAL[:4]))
    assert np.isnan(srgr(REAL, REAL, np.zeros(12)))


def test_a_body_that_stands_still_is_scored_like_any():
    assert srgr(np.zeros_like(REAL), np.zeros_like(REAL)) == 1
    assert srgr(np.zeros_like(REAL), REAL + 10) == 0


def test_inputs_are_not_modified():
    inputs = [REAL + 0.01, REAL.copy(), np.ones(12)]
    before = [x.tobytes() for x in inputs]
    srgr(*inputs)
    assert [x.tobytes() for x in inputs] == before
