"""The probe finds a word where the features tell it, and nothing where they do not."""

import numpy as np

from ha2g_jax.evaluation.word_probe import ProbeWords, predict_classes
from ha2g_jax.metrics.causes import PROBE_ACCURACY
from ha2g_jax.metrics.uncertainty import Estimate


def test_probe_learns_what_is_there_and_not_what_is_not():
    rng = np.random.default_rng(0)
    classes = np.array(["one", "two", "fist"])[rng.integers(0, 3, 600)]
    clips = np.repeat(np.arange(60).astype(str), 10)
    telling = rng.normal(size=(600, 8)) + 4 * np.eye(8)[np.unique(classes, return_inverse=True)[1]]
    for features, low, high in ((telling, 0.9, 1.0), (rng.normal(size=(600, 8)), 0.2, 0.47)):
        train, test = (ProbeWords(features[part], classes[part], clips[part]) for part in np.split(np.arange(600), 2))
        accuracy, majority = map(PROBE_ACCURACY.measure, predict_classes(train, {"test": test})["test"])
        assert isinstance(accuracy, Estimate) and low <= accuracy.value <= high
        assert isinstance(majority, Estimate) and 0.2 < majority.value < 0.5


def test_words_of_one_class_teach_a_probe_nothing():
    clips = np.arange(3).astype(str)
    for count in (0, 3):
        train = ProbeWords(np.zeros((count, 8)), np.full(count, "count"), clips[:count])
        assert predict_classes(train, {"test": ProbeWords(np.zeros((3, 8)), np.full(3, "count"), clips)}) == {}
