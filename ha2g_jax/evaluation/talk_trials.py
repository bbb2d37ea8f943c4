"""Compare motions with the strokes, words and styles that are known to cause them, for metrics of known causes."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ha2g_jax import metrics
from ha2g_jax.data.records import Clip
from ha2g_jax.data.talk import anatomy, lexicon
from ha2g_jax.data.talk.speakers import Style
from ha2g_jax.metrics.beats.strokes import TOLERANCE, match, stroke_beats, wrist_positions
from ha2g_jax.metrics.causes import PROBE_ACCURACY, CauseRow, expected_match, hand_shape, movement, shown_flexions
from ha2g_jax.metrics.uncertainty import Estimate, jackknife
from ha2g_jax.skeleton import Skeleton, positions_to_directions

CLASSES = tuple(lexicon.HAND_SHAPES)
_SHAPES = np.array(list(lexicon.HAND_SHAPES.values()))
_HANDS = {"left": [0], "right": [1], "both": [0, 1]}
_STYLE = [Style._fields.index(name) for name in ("amplitude", "handedness")]


class Observed(NamedTuple):
    """Wrists (T, 2, 3) in metres, times of the beats (n,) in seconds and flexions of the fingers (T, 2, 5)."""

    wrists: np.ndarray
    beats: np.ndarray
    flexions: np.ndarray


class Truth(NamedTuple):
    """A clip with the known causes of its motion.

    Attributes:
        clip: clip with strokes and style.
        strokes: (n,) times of the beats that the sound causes.
        causes: (m,) times of all downward strokes: those, and others of the true motion (the gesture of a word, a hand
            that goes back to rest).
        num_frames: number of frames of the true motion.
    """

    clip: Clip
    strokes: np.ndarray
    causes: np.ndarray
    num_frames: int


class Trial(NamedTuple):
    """A motion and the clip that it is scored against: its own, or another one for the floor."""

    truth: Truth
    observed: Observed


def observe(skeleton: Skeleton, directions: np.ndarray, fps: float) -> Observed:
    """Return wrists, beats and fingers of a motion (T, bones, 3)."""
    wrists = wrist_positions(skeleton, directions)
    return Observed(wrists, stroke_beats(wrists, fps), anatomy.finger_flexions(skeleton, directions))


def known_truth(skeleton: Skeleton, clip: Clip, fps: float) -> Truth:
    """Return the known causes of a clip's motion."""
    strokes = np.array(sorted(stroke.time for stroke in clip.strokes if stroke.kind == "beat"))
    wrists = wrist_positions(skeleton, positions_to_directions(skeleton, clip.positions))
    moves = stroke_beats(wrists, fps)
    others = moves[np.abs(moves[:, None] - strokes[None]).min(axis=1, initial=np.inf) > TOLERANCE]
    return Truth(clip, strokes, np.sort(np.concatenate([strokes, others])), len(clip.positions))


def cause_row(trials: Sequence[Trial], fps: float, first_frame: int) -> CauseRow:
    """Return what the metrics of known causes measure, from the first frame on that was not given to the model."""
    spans = [end - start for start, end in (_shared_time(trial, fps, first_frame) for trial in trials)]
    shapes, flexions, word_clips = word_shapes(trials, fps, first_frame)
    return CauseRow(
        counts=beat_counts(trials, fps, first_frame),
        seconds=np.array(spans),
        clips=np.array([trial.truth.clip.id for trial in trials]),
        shapes=shapes,
        flexions=flexions,
        word_clips=word_clips,
        seen=np.array([movement(trial.observed.wrists, fps) for trial in trials]),
        asked=np.array([trial.truth.clip.style for trial in trials])[:, _STYLE],
        speakers=np.array([trial.truth.clip.speaker for trial in trials]),
    )


def without_speakers(row: CauseRow, name: str) -> dict[str, float]:
    """Measure a metric of known causes without each speaker in turn, for jackknife errors over speakers.

    Returns:
        Name of the speaker -> value of the metric without the speaker; NaN where it is undefined.
    """
    metric, values = metrics.of_section("known_causes")[name], {}
    for speaker in np.unique(row.speakers).tolist():
        found = metric.measure(_without(row, speaker))
        values[speaker] = found.value if isinstance(found, Estimate) else np.nan
    return values


def _without(row: CauseRow, speaker: str) -> CauseRow:
    kept = row.speakers != speaker
    words = np.isin(row.word_clips, row.clips[kept])
    chance = row.mismatched.reshape(len(kept), -1, row.counts.shape[1])[kept].reshape(-1, row.counts.shape[1])
    return row._replace(
        counts=row.counts[kept],
        mismatched=chance if len(row.mismatched) else row.mismatched,
        seconds=row.seconds[kept],
        clips=row.clips[kept],
        shapes=row.shapes[words],
        flexions=row.flexions[words],
        word_clips=row.word_clips[words],
        seen=row.seen[kept],
        asked=row.asked[kept],
        speakers=row.speakers[kept],
    )


def measure_causes(row: CauseRow) -> dict[str, Estimate]:
    """Measure all metrics of known causes that a row has."""
    found = {
        name: metric.measure(row)
        for name, metric in metrics.of_section("known_causes").items()
        if metric is not PROBE_ACCURACY
    }
    return {name: score for name, score in found.items() if isinstance(score, Estimate)}


def beat_counts(trials: Sequence[Trial], fps: float, first_frame: int) -> np.ndarray:
    """Return rows of `Matches` (trials, 4) of beat strokes in the time that clip and motion have in common."""
    counts = []
    for trial in trials:
        start, end = _shared_time(trial, fps, first_frame)
        times = (trial.truth.strokes, trial.truth.causes, trial.observed.beats)
        strokes, causes, moves = (x[(x >= start) & (x < end)] for x in times)
        counts.append(match(strokes, causes, moves))
    return np.array(counts, float).reshape(-1, 4)


def word_shapes(trials: Sequence[Trial], fps: float, first_frame: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return what hands show at the gesture-bearing words: shapes, flexions and clips of words of a `CauseRow`."""
    shapes, flexions, clips = [], [], []
    for trial in trials:
        start, end = _shared_time(trial, fps, first_frame)
        for stroke in trial.truth.clip.strokes:
            if stroke.kind == "semantic" and start <= stroke.time < end:
                hands = trial.observed.flexions[:, _HANDS[stroke.hand]]
                shown, true = shown_flexions(hands, stroke.time, fps), CLASSES.index(stroke.word_class)
                shapes.append((hand_shape(shown, _SHAPES), true))
                flexions.append((shown.mean(axis=0), _SHAPES[true]))
                clips.append(trial.truth.clip.id)
    return (
        np.array(shapes, int).reshape(-1, 2),
        np.array(flexions).reshape(-1, 2, _SHAPES.shape[1]),
        np.array(clips),
    )


def semantic_floors(row: CauseRow) -> tuple[dict[str, Estimate], dict[str, Estimate]]:
    """Return the scores of always showing the most frequent class, and of the same shapes at shuffled words."""
    true = row.shapes[:, 1].tolist()
    most = max(set(true), key=true.count) if true else 0
    return (
        {"semantic_recall": jackknife(row.shapes, lambda part: float(np.mean(part[:, 1] == most)), row.word_clips)},
        {"semantic_recall": jackknife(row.shapes, lambda part: expected_match(*part.T), row.word_clips)},
    )


def _shared_time(trial: Trial, fps: float, first_frame: int) -> tuple[float, float]:
    """Return start and end in seconds of what is scored."""
    return first_frame / fps, min(trial.truth.num_frames, len(trial.observed.wrists)) / fps
