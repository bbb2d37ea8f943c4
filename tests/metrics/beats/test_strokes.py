"""A strike of the hand is found where it is, matched once, and worth nothing by chance."""

import numpy as np
import pytest

from ha2g_jax.metrics.beats.strokes import (
    f1,
    kernel_f,
    kernels,
    match,
    matched_pairs,
    precision,
    recall,
    strict_f1,
    stroke_beats,
    wrist_positions,
)
from ha2g_jax.metrics.beats.times import deep_minima, minima
from ha2g_jax.skeleton import load_skeleton

FPS = 15


def beating_hand(hits: np.ndarray, seconds: float, size: float = 0.1, fps: float = FPS) -> np.ndarray:
    """Wrists (T, 2, 3) of which the left falls by `size` metres 0.22 s before each hit, then slowly rises."""
    time = np.arange(round(seconds * fps)) / fps
    moments = [-9.0, *(t for hit in hits for t in (hit - 0.22, hit, hit + 0.5))]
    heights = [0.0, *([0.0, size, 0.0] * len(hits))]
    after = np.clip(np.searchsorted(moments, time), 1, len(moments) - 1)
    start, end = (np.array(moments)[after - k] for k in (1, 0))
    u = np.clip((time - start) / (end - start), 0, 1)
    first, last = (np.array(heights)[after - k] for k in (1, 0))
    wrists = np.zeros((len(time), 2, 3))
    wrists[:, 0, 1] = first + (last - first) * u**3 * (10 - 15 * u + 6 * u**2)
    return wrists


@pytest.mark.parametrize("fps", [15, 30, 60])
def test_beats_lie_where_the_hand_hits(fps):
    hits = np.array([1.0, 2.03, 3.37, 4.21, 6.5])
    found = stroke_beats(beating_hand(hits, 8, fps=fps), fps)
    np.testing.assert_allclose(found, hits, atol=0.04)


def test_either_hand_beats():
    wrists = beating_hand(np.array([1.0, 2.0]), 4)
    np.testing.assert_allclose(stroke_beats(wrists[:, ::-1], FPS), stroke_beats(wrists, FPS))


def test_no_beat_without_a_strike():
    still = np.ones((100, 2, 3))
    rising = still * np.linspace(0, -1, 100)[:, None, None]
    faint = beating_hand(np.array([1.0, 2.0]), 4, size=0.005)
    for wrists in (still, rising, faint, still[:3], still[:0]):
        assert len(stroke_beats(wrists, FPS)) == 0


def test_minima_need_a_rise_on_both_sides_and_lie_between_samples():
    curve = np.array([3.0, 1.0, 0.0, 0.5, 2.0, 1.9, 1.95, 0.0, 0.0, 4.0])
    np.testing.assert_allclose(deep_minima(curve, 1.0), [2 + 0.5 * (1.0 - 0.5) / 1.5])
    np.testing.assert_allclose(deep_minima(curve, 0.04)[1:], [5 + 0.5 * (2.0 - 1.95) / 0.15])
    assert len(deep_minima(curve, 2.5)) == 0


def test_each_stroke_and_each_beat_is_matched_once():
    strokes, found = np.array([1.0, 1.1, 2.0, 3.0]), np.array([1.05, 2.08, 2.09, 3.11])
    assert matched_pairs(strokes, found) == 2
    assert matched_pairs(np.array([1.0, 1.15]), np.array([0.95, 1.05])) == 2
    assert matched_pairs(strokes, np.zeros(0)) == 0


def test_a_beat_with_another_cause_is_right_but_finds_no_stroke():
    strokes, causes, found = np.array([1.0, 3.0]), np.array([1.0, 2.0, 3.0]), np.array([1.05, 2.05, 4.0])
    counts = np.array([match(strokes, causes, found)])
    assert counts.tolist() == [[2, 1, 3, 2]]
    assert recall(counts) == pytest.approx(1 / 2)
    assert precision(counts) == pytest.approx(2 / 3)
    assert f1(counts) == pytest.approx(4 / 7)
    assert strict_f1(counts) == pytest.approx(2 / 5)


def test_scores_pool_the_clips_and_stillness_is_zero():
    counts = np.array([[4, 2, 2, 2], [4, 2, 6, 2]])
    assert recall(counts) == precision(counts) == f1(counts) == 0.5
    still = np.array([[4, 0, 0, 0]])
    assert f1(still) == precision(still) == recall(still) == f1(0 * still) == strict_f1(0 * still) == 0


def test_kernels_add_up_over_segments_and_score_the_known_distance():
    onsets, moves = np.array([1.0, 2.0, 3.0]), np.array([1.1, 3.0])
    whole = kernels(onsets, moves)
    assert whole == pytest.approx((3, 2, np.exp(-0.5) + np.exp(-0.5 * 9**2) + 1, np.exp(-0.5) + 1))
    parts = np.array([kernels(onsets, moves, 0, 2.5), kernels(onsets, moves, 2.5, 9)])
    np.testing.assert_allclose(parts.sum(axis=0), whole)
    r, q = (np.exp(-0.5) + 1) / 3, (np.exp(-0.5) + 1) / 2
    assert kernel_f(parts) == pytest.approx(2 * r * q / (r + q))
    assert kernel_f(np.array([kernels(onsets, np.zeros(0))])) == 0


def test_wrists_are_those_of_the_mean_pose():
    skeleton = load_skeleton("ted_expressive")
    wrists = wrist_positions(skeleton, skeleton.mean_directions[None])
    assert wrists.shape == (1, 2, 3)
    assert wrists[0, 0, 0] > 0 > wrists[0, 1, 0]  # the person's left is +x


def test_two_equal_samples_are_a_minimum_on_demand():
    curve = np.array([2.0, 1.0, 1.0, 3.0, 0.0, 0.0, 0.0, 4.0, 1.0, 1.0])
    assert len(minima(curve).sample) == 0
    found = minima(curve, equal=True)
    assert (found.sample.tolist(), found.offset.tolist(), found.rise.tolist()) == ([1], [0.5], [1.0])
