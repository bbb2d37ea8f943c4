"""BC by hand from the text of the paper, and how jitter wins it."""

import numpy as np
import pytest

from ha2g_jax.metrics.beats.alignment import align, mismatched
from ha2g_jax.metrics.beats.stops import beat_consistency, consistency, low_samples, make_clips
from ha2g_jax.metrics.beats.summary import summary
from ha2g_jax.metrics.legacy import legacy_motion_beats

FPS = 10


def test_the_examples_of_supplement_e():
    """A rate of 0.2, 0.1, 0.2 is a beat; 0.11, 0.1, 0.11, 0.1, 0.11 has none that exceeds the threshold."""
    assert low_samples(np.array([0.2, 0.1, 0.2]), 0.03).tolist() == [1]
    assert low_samples(np.array([0.11, 0.1, 0.11, 0.1, 0.11]), 0.03).tolist() == []
    assert low_samples(np.array([0.11, 0.1, 0.2]), 0.03).tolist() == [1], "a rise on one side is enough"
    assert low_samples(np.array([0.3, 0.1]), 0.03).tolist() == low_samples(np.zeros(0), 0.03).tolist() == []


def test_bc_is_the_mean_of_the_kernel_over_all_onsets():
    rate = np.ones(30)
    rate[[10, 20]] = 0.5  # stops between frames 10 and 11, and 20 and 21
    onsets = [np.array([1.05, 1.95, 2.75]), np.array([0.8]), np.zeros(0)]
    found = consistency([rate, np.ones(30), rate], onsets, FPS)
    distances = np.array([0, 0.1, 0.7, np.inf])  # the second clip has no beat, the third no onset
    assert beat_consistency(found) == pytest.approx(np.exp(-(distances**2) / (2 * 0.1**2)).mean())
    assert np.isnan(beat_consistency(consistency([rate], [np.zeros(0)], FPS)))


def test_what_lies_before_the_first_frame_is_not_scored():
    rate = np.ones(30)
    rate[2] = 0.5
    assert beat_consistency(consistency([rate], [np.array([0.25, 1.0])], FPS)) == 0
    assert beat_consistency(consistency([rate], [np.array([0.25, 1.0])], FPS, first_frame=0)) == pytest.approx(0.5)


def test_the_release_finds_the_same_samples():
    """Its times are those of the later of the two frames that a change is between."""
    rate = np.random.default_rng(0).uniform(0, 1, 33)
    np.testing.assert_allclose(legacy_motion_beats(rate), (low_samples(rate, 0.03) + 1) / 15)


def test_jitter_scores_higher_than_stops_at_every_other_onset():
    random = np.random.default_rng(0)
    stops, onsets = [], []
    for _ in range(50):
        times = np.cumsum(random.uniform(0.3, 0.6, 8))
        rate = np.ones(60)
        rate[np.round(times[::2] * 15 - 0.5).astype(int)] = 0.1
        stops.append(rate)
        onsets.append(times)
    jitter = [random.uniform(0, 2, 60) for _ in range(50)]
    scores = [beat_consistency(consistency(rates, onsets, 15)) for rates in (jitter, stops)]
    gains = [
        summary(align(clips), mismatched(clips, np.arange(50))).gain
        for clips in (make_clips(rates, onsets, 15) for rates in (jitter, stops))
    ]
    assert scores[0] > scores[1] and gains[1] > 0.1 > gains[0]
