"""Predict the words of a Talk corpus from what the audio encoder of a model represents.

The probe tells whether the encoder represents the word: if it is above its floor while the hands are at theirs, the
decoder is at fault. It is not part of the objective; no label reaches the model.
"""

import warnings
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from tqdm import tqdm

from ha2g_jax.data.corpus import TRAIN, Corpus
from ha2g_jax.data.records import Clip
from ha2g_jax.data.talk import lexicon
from ha2g_jax.evaluation.clip_result import sample
from ha2g_jax.metrics.causes import Predictions
from ha2g_jax.synthesis import Model, encode_features

MAX_PROBE_CLIPS = 400  # of the training split


class ProbeWords(NamedTuple):
    """Words that carry a gesture: f_high (n, 32) at their onsets, their classes and the ids of their clips."""

    features: np.ndarray
    classes: np.ndarray
    clips: np.ndarray


def probe_words(
    model: Model, corpus: Corpus, chosen: Mapping[str, Sequence[Clip]], seed: int, progress: tqdm
) -> dict[str, tuple[Predictions, Predictions]]:
    """Predict the classes of words in the clips of each split, with a probe that training clips of the corpus fit.

    A model with audio levels encodes `MAX_PROBE_CLIPS` training clips at the most, which `seed` chooses; `progress`
    counts every clip.

    Returns:
        See `predict_classes`.
    """

    def collect(clips: Iterable[Clip]) -> ProbeWords:
        return collect_words(map(encode, clips), model.fps)

    def encode(clip: Clip) -> tuple[Clip, np.ndarray]:
        progress.update()
        return clip, np.asarray(encode_features(model, clip.audio).high)

    training = corpus.clips(TRAIN)
    fitted = (training[index] for index in sample(len(training), MAX_PROBE_CLIPS, seed))
    return predict_classes(collect(fitted), {split: collect(clips) for split, clips in chosen.items()})


def collect_words(clips: Iterable[tuple[Clip, np.ndarray]], fps: float) -> ProbeWords:
    """Collect the gesture-bearing words of clips, each given with its f_high (T, 32)."""
    features, classes, ids = [], [], []
    for clip, high in clips:
        for word in clip.words:
            frame = int(word.start * fps)
            if (name := lexicon.word_class(word.text)) and frame < len(high):
                features.append(high[frame])
                classes.append(name)
                ids.append(clip.id)
    return ProbeWords(np.array(features), np.array(classes), np.array(ids))


def predict_classes(train: ProbeWords, splits: Mapping[str, ProbeWords]) -> dict[str, tuple[Predictions, Predictions]]:
    """Predict the classes of words from f_high by multinomial logistic regression, fitted to training clips only.

    Returns:
        {split: the predictions, and those of always choosing the most frequent class of `train`} for splits with words;
        {} if the training clips have fewer than two classes.
    """
    names, counts = np.unique(train.classes, return_counts=True)
    if len(names) < 2:
        return {}
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.linear_model import LogisticRegression
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    model = make_pipeline(StandardScaler(), LogisticRegression(max_iter=2000))
    with warnings.catch_warnings():
        # Features of an untrained encoder may be constant; the probe is then at its floor, which the table shows.
        warnings.simplefilter("ignore", ConvergenceWarning)
        model.fit(train.features, train.classes)
    most = names[np.argmax(counts)]
    return {
        split: (
            Predictions(np.equal(model.predict(words.features), words.classes), words.clips),
            Predictions(words.classes == most, words.clips),
        )
        for split, words in splits.items()
        if len(words.classes)
    }
