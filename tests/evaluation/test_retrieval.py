"""Retrieved motion is that of the training window with the most similar sound."""

import json

import numpy as np
import pytest

from ha2g_jax.data.corpus import TRAIN, Corpus
from ha2g_jax.evaluation import retrieval
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
