"""Does the audio encoder hear the word? A linear probe for the word's class on frozen f_high.

Beside the recall of the hand shapes it separates "did not hear" from "did not move": a probe above its floor with
hands at theirs blames the decoder. The probe is outside of the objective; no label reaches the model.
"""

import warnings
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from sklearn.exceptions import ConvergenceWarning
from sklearn.linear_model import LogisticRegression
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from ha2g_jax.data.records import Clip
from ha2g_jax.data.talk import lexicon
from ha2g_jax.metrics.jackknife import Estimate, jackknife


class Heard(NamedTuple):
    """Words that carry a gesture, and what the encoder makes of them.

    Attributes:
        features: (n, 32) f_high at the onset of each word.
        classes: (n,) class of each word.
        clips: (n,) id of the clip each word is in.
    """

    features: np.ndarray
    classes: np.ndarray
    clips: np.ndarray


def hear(clips: Iterable[tuple[Clip, np.ndarray]], fps: float) -> Heard:
    """The gesture-bearing words of clips.

    Args:
        clips: each with its f_high, (T, 32).
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
    return Heard(np.array(features), np.array(classes), np.array(ids))


def accuracy(train: Heard, splits: dict[str, Heard]) -> dict[str, dict[str, Estimate]]:
    """Accuracy of multinomial logistic regression, fitted to the words of training clips only, and its floor.

    Args:
        train: words to fit to, of at least two classes.
        splits: words to score on.

    Returns:
        Per split `accuracy`, and `majority`: that of naming the most frequent class of `train` each time.
    """
    model = make_pipeline(StandardScaler(), LogisticRegression(max_iter=2000))
    with warnings.catch_warnings():
        # Features of an untrained encoder may be constant; the probe is then at its floor, which the table shows.
        warnings.simplefilter("ignore", ConvergenceWarning)
        model.fit(train.features, train.classes)
    names, counts = np.unique(train.classes, return_counts=True)
    most = names[np.argmax(counts)]
    return {
        split: {
            "accuracy": _share(model.predict(heard.features) == heard.classes, heard.clips),
            "majority": _share(heard.classes == most, heard.clips),
        }
        for split, heard in splits.items()
        if len(heard.classes)
    }


def _share(is_right: np.ndarray, clips: np.ndarray) -> Estimate:
    return jackknife(is_right, lambda part: float(np.mean(part)), clips)
