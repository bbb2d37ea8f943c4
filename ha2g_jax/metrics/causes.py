"""Scores of a motion whose causes are known: matched strokes, hand shapes at words, and the requested style."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ha2g_jax.metrics.beats.strokes import f1, precision, recall, strict_f1
from ha2g_jax.metrics.metric import KNOWN_CAUSES, PROBE, Metric
from ha2g_jax.metrics.reconstruction import correlation
from ha2g_jax.metrics.uncertainty import Estimate, jackknife

SHAPE_WINDOW = (-0.1, 0.2)  # seconds around the moment of the gesture in which a hand shape should be seen


class CauseRow(NamedTuple):
    """Measurements of n motions whose causes are known; a row may lack any of them, which are then empty.

    Attributes:
        counts: (n, 4) rows of `strokes.Matches`.
        mismatched: (k n, 4) the same for k motions of other clips, clip by clip: the chance level.
        seconds: (n,) length of the scored part.
        clips: (n,) id of each clip.
        shapes: (words, 2) class of the shown hand shape and class of the word, for each gesture-bearing word.
        flexions: (words, 2, 5) shown flexion of the fingers and that of the word's class, mean over the hands.
        word_clips: (words,) id of the clip of each word.
        seen: (n, 2) measured amplitude and handedness.
        asked: (n, 2) requested amplitude and handedness.
        speakers: (n,) name of each clip's speaker.
        takes: (m, 3) rows of `takes.TakeDistances` of some clips.
    """

    counts: np.ndarray = np.zeros((0, 4))
    mismatched: np.ndarray = np.zeros((0, 4))
    seconds: np.ndarray = np.zeros(0)
    clips: np.ndarray = np.zeros(0, str)
    shapes: np.ndarray = np.zeros((0, 2), int)
    flexions: np.ndarray = np.zeros((0, 2, 5))
    word_clips: np.ndarray = np.zeros(0, str)
    seen: np.ndarray = np.zeros((0, 2))
    asked: np.ndarray = np.zeros((0, 2))
    speakers: np.ndarray = np.zeros(0, str)
    takes: np.ndarray = np.zeros((0, 3))

    def take(self, kept: np.ndarray) -> "CauseRow":
        """Return the row of those motions that a mask (n,) keeps; `takes` stays complete."""
        words = np.isin(self.word_clips, self.clips[kept])
        masks: dict[str, np.ndarray] = dict.fromkeys(("shapes", "flexions", "word_clips"), words)
        masks["mismatched"] = np.repeat(kept, len(self.mismatched) // max(len(kept), 1))
        parts = {name: part for name, part in self._asdict().items() if len(part) and name != "takes"}
        return self._replace(**{name: part[masks.get(name, kept)] for name, part in parts.items()})


class Predictions(NamedTuple):
    """Whether the class of each word is predicted (n,), and the id of each word's clip (n,)."""

    is_right: np.ndarray
    clips: np.ndarray


def shown_flexions(flexions: np.ndarray, time: float, fps: float) -> np.ndarray:
    """Return the mean flexion (hands, 5) in `SHAPE_WINDOW` around the time of a word, or that of the nearest frame if
    none is in it.
    """
    frames = np.arange(len(flexions)) / fps - time
    seen = (frames >= SHAPE_WINDOW[0]) & (frames <= SHAPE_WINDOW[1])
    if not seen.any():
        seen = np.abs(frames) == np.abs(frames).min()
    return flexions[seen].mean(axis=0)


def hand_shape(shown: np.ndarray, shapes: np.ndarray) -> int:
    """Return the index of the shape (classes, 5) that hands (hands, 5) take: the template with the least Euclidean
    distance, summed over hands.
    """
    return int(np.argmin(np.linalg.norm(shown[None] - shapes[:, None], axis=-1).sum(axis=-1)))


def expected_match(predicted: np.ndarray, true: np.ndarray) -> float:
    """Return the expected fraction of words that match when predictions are shuffled: the sum of p(c) q(c) over c."""
    names = np.unique(np.concatenate([predicted, true]))
    return float(sum(np.mean(predicted == name) * np.mean(true == name) for name in names))


def finger_correlation(flexions: np.ndarray) -> float:
    """Return the correlation over words and fingers of the shown flexion with that of the word's class.

    The mean of each finger of the flexions (words, 2, 5), shown and of the class, is subtracted first, so that a pose
    that is the same at all words has no correlation. Unlike the nearest shape, which is then still that of a resting
    hand, it detects hands that move part of the way to a shape.
    """
    centred = flexions - flexions.mean(axis=0, keepdims=True)
    return correlation(centred.swapaxes(1, 2).reshape(-1, 2))


def movement(wrists: np.ndarray, fps: float) -> tuple[float, float]:
    """Measure the visible amplitude and handedness of a motion, from positions (T, 2, 3) of the left and right wrist.

    They are the mean speed of the faster wrist in m/s, and (right - left) / (right + left) of the mean speeds, 0 at
    rest. (Of simple measures of amplitude this one follows the style of the teacher of the Talk corpus best: r = 0.79.)
    """
    speeds = np.linalg.norm(np.diff(wrists, axis=0), axis=-1) * fps
    left, right = speeds.mean(axis=0)
    return float(speeds.max(axis=1).mean()), float((right - left) / (right + left)) if right + left else 0.0


def gain(
    own: np.ndarray, mismatched: np.ndarray, clips: np.ndarray, statistic: Callable[[np.ndarray], float] = f1
) -> Estimate:
    """Compute a score minus the chance level, with the standard error over clips of the paired difference.

    The rows (clips, 4) of `strokes.Matches` are compared with those (k clips, 4) of k motions for other clips, clip by
    clip; without any the result is NaN. The statistic is a function of such rows.
    """
    if not len(mismatched):
        return Estimate(np.nan, np.nan)
    floor = mismatched.reshape(len(own), -1, own.shape[1]).mean(axis=1)
    both = np.stack([own, floor], axis=1)
    return jackknife(both, lambda pair: statistic(pair[:, 0]) - statistic(pair[:, 1]), np.asarray(clips))


def _of_counts(statistic: Callable[[np.ndarray], float]) -> Callable[[CauseRow], Estimate | None]:
    return lambda row: jackknife(row.counts, statistic, row.clips) if len(row.counts) else None


def _gain(statistic: Callable[[np.ndarray], float]) -> Callable[[CauseRow], Estimate | None]:
    return lambda row: gain(row.counts, row.mismatched, row.clips, statistic) if len(row.mismatched) else None


def _rate(row: CauseRow) -> Estimate | None:
    samples = np.stack([row.counts[:, 2], row.seconds], axis=1)
    if not len(samples):
        return None
    return jackknife(samples, lambda rows: float(rows[:, 0].sum() / rows[:, 1].sum()), row.clips)


def _recall(row: CauseRow) -> Estimate | None:
    if not len(row.shapes) and not len(row.counts):
        return None
    return jackknife(row.shapes, lambda pairs: float(np.mean(pairs[:, 0] == pairs[:, 1])), row.word_clips)


def _finger_correlation(row: CauseRow) -> Estimate | None:
    return jackknife(row.flexions, finger_correlation, row.word_clips) if len(row.flexions) else None


def _style(column: int) -> Callable[[CauseRow], Estimate | None]:
    """Return a measure: the correlation over clips of the requested and the measured value, with error by speaker."""

    def measure(row: CauseRow) -> Estimate | None:
        pairs = np.stack([row.seen[:, column], row.asked[:, column]], axis=1)
        return jackknife(pairs, correlation, row.speakers) if len(pairs) else None

    return measure


def _accuracy(row: Predictions) -> Estimate:
    return jackknife(row.is_right, lambda part: float(np.mean(part)), row.clips)


def _metric(name: str, title: str, measure: Callable[[CauseRow], Estimate | None], unit: str = "") -> Metric:
    return Metric(name, title, unit, "higher", KNOWN_CAUSES, 2, measure, "known_causes")


CAUSE_METRICS = (
    _metric("beat_f1", "beat F1", _of_counts(f1)),
    _metric("beat_f1_gain", "beat F1 gain", _gain(f1)),
    _metric("beat_f1_strict", "strict F1", _of_counts(strict_f1)),
    _metric("beat_f1_strict_gain", "strict F1 gain", _gain(strict_f1)),
    _metric("stroke_recall", "recall", _of_counts(recall)),
    _metric("stroke_precision", "precision", _of_counts(precision)),
    Metric("strokes_per_second", "strokes", "/s", "none", KNOWN_CAUSES, 2, _rate, "known_causes"),
    _metric("semantic_recall", "hand shape", _recall),
    _metric("finger_correlation", "fingers r", _finger_correlation),
    _metric("style_amplitude", "amplitude r", _style(0)),
    _metric("style_handedness", "handedness r", _style(1)),
)
PROBE_ACCURACY = Metric("probe_accuracy", "accuracy", "", "higher", PROBE, 2, _accuracy, "known_causes")
