"""Scores of a run: motion by retrieval, thresholds of Figure 3, and scores without each recording."""

import json

import numpy as np
import pytest
from tables import retrieval
from tables.look_aheads import ABOVE_FLOOR, GAIN
from tables.paper_tables import THRESHOLDS
from tables.scores import leave_one_out, sweep

from ha2g_jax.data.corpus import TRAIN, Corpus
from ha2g_jax.metrics.beats import strokes
from ha2g_jax.metrics.beats.alignment import align, mismatched
from ha2g_jax.metrics.beats.stops import beat_consistency, consistency, make_clips
from ha2g_jax.metrics.causes import CauseRow
from ha2g_jax.skeleton import positions_to_directions


@pytest.fixture(scope="module")
def corpus(tiny_talk):
    return Corpus.open(tiny_talk)


@pytest.fixture(scope="module")
def library(corpus):
    return retrieval.make_library(corpus)


def _retrieve(library, corpus, split):
    stored = json.dumps(retrieval.nearest_windows(library, corpus, split))
    return retrieval.join_motion(corpus, split, json.loads(stored))


def test_speech_of_training_gets_its_own_motion_back(corpus, library):
    """The windows of the result are windows of the library, up to the last one, which is longer than the clip."""
    for clip, found in zip(corpus.clips(TRAIN), _retrieve(library, corpus, TRAIN), strict=True):
        own = positions_to_directions(corpus.skeleton, clip.positions)
        assert found.id == clip.id and found.directions.shape == own.shape
        whole = (len(own) - 34) // 30 * 30
        np.testing.assert_allclose(found.directions[:whole], own[:whole], atol=1e-5)


def test_other_speech_gets_unit_vectors_of_its_own_length(corpus, library):
    found = _retrieve(library, corpus, "test")
    lengths = [len(clip.positions) for clip in corpus.clips("test")]
    assert [len(clip.directions) for clip in found] == lengths
    for clip in found:
        np.testing.assert_allclose(np.linalg.norm(clip.directions, axis=-1), 1, atol=1e-5)
        assert clip.borders == tuple(range(30, len(clip.directions) - 4, 30))


def test_the_voice_is_left_out(corpus, library):
    """A louder band throughout does not change what is nearest."""
    rng = np.random.default_rng(0)
    mel = rng.uniform(-80, 0, (128, 70))
    coloured = mel + rng.uniform(-10, 10, (128, 1))
    plain, other = (retrieval._sound(each, 0, 34, 15.0) for each in (mel, coloured))
    np.testing.assert_allclose(plain, other, atol=1e-6)


def test_sweep_over_thresholds_is_each_threshold_alone():
    rng = np.random.default_rng(0)
    rates, onsets = list(rng.uniform(0.8, 1.2, (30, 60))), list(rng.uniform(0, 4, (30, 8)))
    recordings = np.arange(30) // 2
    found = sweep(rates, onsets, recordings, 15)
    for index in (0, 2, 29):
        clips = make_clips(rates, onsets, 15, threshold=THRESHOLDS[index])
        assert found["own"][index] == pytest.approx(align(clips).f.mean())
        assert found["mismatched"][index] == pytest.approx(mismatched(clips, recordings).mean())
        alone = consistency(rates, onsets, 15, threshold=THRESHOLDS[index])
        assert found["consistency"][index] == beat_consistency(alone)
    assert found["consistency"][0] > found["consistency"][-1]


def test_scores_without_a_recording_are_those_of_the_other_clips():
    row = CauseRow(
        counts=np.array([[4, 2, 5, 3], [6, 6, 6, 6], [2, 0, 3, 1]], float),
        mismatched=np.array([[4, 1, 5, 2]] * 2 + [[6, 0, 6, 1]] * 2 + [[2, 1, 3, 2]] * 2, float),
        clips=np.array(["a0", "a1", "b0"]),
        shapes=np.array([[0, 0], [1, 0], [1, 1], [2, 2]]),
        word_clips=np.array(["a0", "a1", "b0", "b0"]),
    )
    found = leave_one_out(row, ["a", "a", "b"])
    assert found["beat_f1"]["without"] == [strokes.f1(row.counts[2:]), strokes.f1(row.counts[:2])]
    gains = [
        strokes.f1(row.counts[part]) - strokes.f1(row.mismatched[::2][part]) for part in (slice(2, 3), slice(0, 2))
    ]
    assert found[GAIN]["without"] == pytest.approx(gains)
    assert found["semantic_recall"] == {"value": 0.75, "without": [1.0, 0.5]}
    # Half of all words are of class 0; at shuffled words 1/4 x 1/2 + 1/2 x 1/4 + 1/4 x 1/4 of the shapes match.
    assert found["semantic_floor"]["value"] == 0.5 and found[ABOVE_FLOOR]["value"] == 0.25
