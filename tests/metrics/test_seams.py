"""A border that jumps is seen, one that does not is not, and jumps are seldom found where there are none."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from ha2g_jax.metrics import seams
from ha2g_jax.skeleton import normalize

FPS = 15
BORDERS = np.arange(30, 300, 30)


def smooth_motion(rng: np.random.Generator, frames: int = 304, size: float = 1.0) -> np.ndarray:
    noise = gaussian_filter1d(rng.normal(size=(frames, 4, 3)), 4, axis=0, mode="wrap")
    return normalize(np.array([0, 1.0, 0]) + size * noise)


def with_jumps(motion: np.ndarray, size: float) -> np.ndarray:
    """Each window leans another way, without any blending."""
    leans = np.where((np.arange(len(motion)) // 30) % 2, size, -size)
    return normalize(motion + leans[:, None, None] * np.array([1.0, 0, 0]))


def test_jumps_of_stretches_by_hand():
    directions = np.zeros((9, 2, 3))
    directions[:, 0, 0] = [9, 0, 0, 1, 1, 1, 1, 4, 4]  # the second bone stands
    jumps = seams.stretch_jumps(directions, 10, width=3, first_frame=1)
    # Half of |first difference| x 10 and of |second difference| x 100, the greatest of three frames.
    np.testing.assert_allclose(jumps[3:7], [[5, 50], [0, 50], [15, 150], [15, 150]])
    assert np.isnan(jumps[[0, 1, 7, 8]]).any(axis=1).all()
    assert jumps[2, 0] == 5 and np.isnan(jumps[2, 1])


def test_each_border_is_grouped_with_the_stretches_around_it():
    jumps = np.tile(np.arange(60.0)[:, None], (1, 2))
    jumps[:3], jumps[-3:] = np.nan, np.nan  # stretches of 4 frames start at 3 to 56
    groups = seams.border_groups(jumps, np.array([51, 32, 12, -1, 0, 60]), width=4)
    assert [group[:, 0].tolist() for group in groups] == [[12, 4, 8, 16, 20], [32, 28, 36], [51, 47, 55]]


def test_no_stretch_is_in_two_groups():
    jumps = np.tile(np.arange(300.0)[:, None], (1, 2))
    stretches = np.concatenate([group[:, 0] for group in seams.border_groups(jumps, BORDERS)])
    frames = stretches[:, None] + np.arange(seams.WIDTH)
    assert frames.size == len(np.unique(frames)) == 9 * 5 * 6


def test_motion_that_grows_calmer_has_no_seams():
    pace = np.exp(-np.arange(304) / 40)
    angle = np.cumsum(pace * np.random.default_rng(0).uniform(0.9, 1.1, 304))
    clip = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)[:, None]
    score = seams.seam_score([clip], [BORDERS], FPS)
    assert score.velocity == pytest.approx(1, abs=0.1)
    assert score.velocity_p > 0.1


def test_a_ratio_by_hand():
    steps = np.full(41, 0.1)
    steps[20] = 0.4  # the step into frame 20
    directions = np.zeros((41, 1, 3))
    directions[:, 0, 1] = np.cumsum(steps)
    score = seams.seam_score([directions], [np.array([20])], FPS)
    assert score.velocity == pytest.approx(4)
    assert score.acceleration > 1e6  # none inside but rounding
    assert score.borders == 1


def test_blended_but_wrong_borders_are_seen_and_jumps_more_so():
    rng = np.random.default_rng(0)
    clips = [smooth_motion(rng) for _ in range(4)]
    borders = [BORDERS] * 4
    clean = seams.seam_score(clips, borders, FPS)
    assert clean.velocity == pytest.approx(1, abs=0.15) and clean.acceleration == pytest.approx(1, abs=0.15)
    assert clean.borders == 36
    small = seams.seam_score([with_jumps(clip, 0.2) for clip in clips], borders, FPS)
    large = seams.seam_score([with_jumps(clip, 0.5) for clip in clips], borders, FPS)
    assert clean.velocity < small.velocity < large.velocity
    assert max(small.velocity_p, small.acceleration_p) < 0.01 < min(clean.velocity_p, clean.acceleration_p)


def test_where_nothing_is_wrong_p_is_uniform():
    rng = np.random.default_rng(1)
    scores = []
    for seed in range(200):
        clips = [smooth_motion(rng, 124, size) for size in (0.5, 2.0)]
        scores.append(seams.seam_score(clips, [BORDERS[:3]] * 2, FPS, draws=99, seed=seed))
    for p in (np.array([score[column] for score in scores]) for column in (2, 3)):
        assert p.mean() == pytest.approx(0.5, abs=0.08)
        assert np.mean(p <= 0.1) == pytest.approx(0.1, abs=0.07)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_turning_the_body_changes_nothing_and_speed_does_not_matter(seed):
    rng = np.random.default_rng(seed)
    clip = smooth_motion(rng)
    score = seams.seam_score([clip], [BORDERS], FPS, draws=50)
    turned = clip @ Rotation.from_rotvec(rng.normal(size=3)).as_matrix().T
    assert seams.seam_score([turned], [BORDERS], FPS, draws=50) == pytest.approx(score)
    assert seams.seam_score([clip], [BORDERS], 60, draws=50) == pytest.approx(score)


def test_motion_that_stands_still_has_no_seams():
    score = seams.seam_score([np.ones((100, 4, 3), np.float32)], [BORDERS], FPS)
    assert score == (1, 1, 1, 1, 2)  # after frame 90 there is no room for an inside


def test_undefined_without_a_border():
    for frames, borders in ((100, []), (0, [30]), (5, [2]), (34, [30]), (100, [200])):
        score = seams.seam_score([np.ones((frames, 4, 3))], [np.array(borders)], FPS)
        assert np.isnan(score[:4]).all() and score.borders == 0
