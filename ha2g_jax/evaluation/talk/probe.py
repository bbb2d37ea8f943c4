"""Linear probe for the class of a word on frozen f_high: whether the audio encoder represents the word.

Beside the recall of the hand shapes it separates the encoder from the decoder: a probe above its floor with hands at
theirs points to the decoder. The probe is outside of the objective; no label reaches the model.
"""

import warnings
from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np
from sklearn.exceptions import ConvergenceWarning
from sklearn.linear_model import LogisticRegression
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from ha2g_jax.data.records import Clip
from ha2g_jax.data.talk import lexicon
from ha2g_jax.metrics.causes import Predictions

__all__ = ["Predictions", "ProbeWords", "collect_words", "predict"]


class ProbeWords(NamedTuple):
    """Words that carry a gesture, with their audio features.

    Attributes:
        features: (n, 32) f_high at the onset of each word.
        classes: (n,) class of each word.
        clips: (n,) id of the clip of each word.
    """

    features: np.ndarray
    classes: np.ndarray
    clips: np.ndarray


def collect_words(clips: Iterable[tuple[Clip, np.ndarray]], fps: float) -> ProbeWords:
    """Collect the gesture-bearing words of clips.

    Args:
        clips: clips, each with f_high (T, 32).
        fps: frames per second of f_high.
    """
    features, classes, ids = [], [], []
    for clip, high in clips:
        for word in clip.words:
            frame = int(word.start * fps)
            if (name := lexicon.word_class(word.text)) and frame < len(high):
                features.append(high[frame])
                classes.append(name)
                ids.append(clip.id)
    return ProbeWords(np.array(features), np.array(classes), np.array(ids))


def predict(train: ProbeWords, splits: Mapping[str, ProbeWords]) -> dict[str, tuple[Predictions, Predictions]]:
    """Predict the classes of words by multinomial logistic regression, fitted to the words of training clips only.

    Args:
        train: words to fit to, of at least two classes.
        splits: name of each split -> words to predict.

    Returns:
        {split: the predictions, and those of the most frequent class of `train` each time}, of splits with words.
    """
    model = make_pipeline(StandardScaler(), LogisticRegression(max_iter=2000))
    with warnings.catch_warnings():
        # Features of an untrained encoder may be constant; the probe is then at its floor, which the table shows.
        warnings.simplefilter("ignore", ConvergenceWarning)
        model.fit(train.features, train.classes)
    names, counts = np.unique(train.classes, return_counts=True)
    most = names[np.argmax(counts)]
    return {
        split: (
            Predictions(model.predict(words.features) == words.classes, words.clips),
            Predictions(words.classes == most, words.clips),
        )
        for split, words in splits.items()
        if len(words.classes)
    }
