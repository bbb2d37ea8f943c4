"""The rows that stand beside every model are what their names say."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ha2g_jax.errors import UserError
from ha2g_jax.metrics import sanity
from ha2g_jax.skeleton import load_skeleton, normalize

SKELETON = load_skeleton("ted_gesture")
MEAN = SKELETON.mean_directions


def motion(frames: int, seed: int = 0) -> np.ndarray:
    walk = np.cumsum(np.random.default_rng(seed).normal(0, 0.05, (frames, 9, 3)), axis=0)
    return normalize(MEAN + walk).astype(np.float32)


CLIPS = [motion(34), motion(90, 1)]
ROWS = sanity.rows(CLIPS, MEAN)


def test_every_row_has_unit_vectors_for_every_frame_of_every_clip():
    assert list(ROWS) == [sanity.MEAN_POSE, sanity.FROZEN, sanity.JITTER, sanity.SMOOTHED]
    for clips in ROWS.values():
        for clip, real in zip(clips, CLIPS, strict=True):
            assert clip.shape == real.shape and clip.dtype == np.float64
            np.testing.assert_allclose(np.linalg.norm(clip, axis=-1), 1)


def test_the_mean_pose_is_the_mean_in_every_frame():
    np.testing.assert_allclose(ROWS[sanity.MEAN_POSE][0][[0, 17, 33]], np.tile(normalize(MEAN), (3, 1, 1)), rtol=1e-6)


def test_frozen_motion_holds_the_last_seed_pose():
    real = CLIPS[0]
    np.testing.assert_allclose(ROWS[sanity.FROZEN][0][:4], real[:4], atol=1e-6)
    np.testing.assert_allclose(ROWS[sanity.FROZEN][0][4:], np.tile(real[3:4], (30, 1, 1)), atol=1e-6)


def test_jitter_is_white_and_as_large_as_real_differences():
    spread = sanity.difference_spread(CLIPS)
    steps = np.concatenate([np.diff(clip[4:], axis=0) for clip in CLIPS])
    np.testing.assert_allclose(spread, steps.std(axis=0), rtol=1e-4)
    small = np.full((9, 3), 0.01)
    jitter = sanity.white_jitter(np.zeros((4000, 9, 3)), MEAN, small, np.random.default_rng(0))
    pose = normalize(MEAN)
    np.testing.assert_allclose(jitter.mean(axis=0), pose, atol=1e-3)
    # Normalising takes away the part along the bone: s^2 (1 - d^2) remains of each channel.
    np.testing.assert_allclose(jitter.var(axis=0), 1e-4 * (1 - pose**2), atol=1e-5)
    noise = jitter - jitter.mean(axis=0)
    assert abs(np.sum(noise[1:] * noise[:-1]) / np.sum(noise**2)) < 0.02


def test_smoothing_is_the_mean_of_five_frames():
    real = CLIPS[1].astype(np.float64)
    for frame in (0, 1, 2, 40, 88, 89):
        expected = normalize(real[max(0, frame - 2) : frame + 3].mean(axis=0))
        np.testing.assert_allclose(ROWS[sanity.SMOOTHED][1][frame], expected, atol=1e-6)


@pytest.mark.parametrize("frames", [0, 1, 3, 4, 5])
def test_short_clips_have_rows_too(frames):
    for clips in sanity.rows([motion(10)[:frames]], MEAN).values():
        assert clips[0].shape == (frames, 9, 3) and np.isfinite(clips[0]).all()


@settings(max_examples=60, deadline=None)
@given(st.lists(st.integers(0, 5), min_size=2, max_size=40), st.integers(0, 2**32 - 1))
def test_no_clip_gets_speech_of_its_own_source(numbers, seed):
    sources = [f"video{number}" for number in numbers]
    if len(set(sources)) == 1:
        with pytest.raises(UserError, match="of one recording; mismatched speech"):
            sanity.derangement(sources, np.random.default_rng(seed))
        return
    others = sanity.derangement(sources, np.random.default_rng(seed))
    assert all(sources[i] != sources[other] for i, other in enumerate(others))
    if 2 * max(sources.count(name) for name in sources) <= len(sources):
        assert sorted(others) == list(range(len(sources)))  # each is used once


def test_equal_lengths_are_preferred_and_the_nearest_is_next():
    sources = ["a", "b", "a", "b", "c", "c", "c"]
    lengths = [34, 34, 34, 34, 90, 80, 33]
    for seed in range(20):
        others = sanity.derangement(sources, np.random.default_rng(seed), lengths=lengths)
        assert [lengths[i] for i in others[:4]] == [34] * 4
        assert set(others[4:]) <= {0, 1, 2, 3}
        assert all(sources[i] != sources[other] for i, other in enumerate(others))


def test_onsets_of_a_shorter_clip_are_repeated_for_the_whole_motion():
    many, two = np.arange(0.5, 60), np.array([1.0, 2.5])
    onsets = [many, np.append(two, 4.5), None, np.array([0.5])]
    long, short, silent, other = sanity.mismatched_onsets(onsets, ["a", "b", "c", "b"], [900, 60, 60, 45], 15.0)
    assert silent is None
    np.testing.assert_array_equal(long, (np.arange(15)[:, None] * 4 + two).ravel())  # of the nearest length
    for found in (short, other):
        np.testing.assert_array_equal(found, many)
    assert sanity.mismatched_onsets(onsets[:3], ["a", "a", "b"], [900, 60, 60], 15.0) == [None, None, None]
