"""One row of the table of scores: motions against the strokes, words and styles that are known to cause them."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from ha2g_jax.data.records import Clip
from ha2g_jax.data.talk import anatomy, lexicon
from ha2g_jax.data.talk.style import Style
from ha2g_jax.metrics import beats, talk
from ha2g_jax.metrics.jackknife import Estimate, jackknife
from ha2g_jax.skeleton import Skeleton, positions_to_directions

CLASSES = tuple(lexicon.HAND_SHAPES)
_SHAPES = np.array(list(lexicon.HAND_SHAPES.values()))
_HANDS = {"left": [0], "right": [1], "both": [0, 1]}
_AMPLITUDE, _HANDEDNESS = (Style._fields.index(name) for name in ("amplitude", "handedness"))


class Seen(NamedTuple):
    """What a row of the table looks at in a motion.

    Attributes:
        wrists: (T, 2, 3) metres.
        beats: (n,) times of the motion beats in seconds.
        flexions: (T, 2, 5) of the fingers.
    """

    wrists: np.ndarray
    beats: np.ndarray
    flexions: np.ndarray


class Truth(NamedTuple):
    """A clip and what is known of its motion.

    Attributes:
        clip: with strokes and style.
        strokes: (n,) times of the beats that the sound causes.
        causes: (m,) times of all downward strokes: those, and whatever else the true motion does (a word's gesture, a
            hand that goes back to rest).
        num_frames: of the true motion.
    """

    clip: Clip
    strokes: np.ndarray
    causes: np.ndarray
    num_frames: int


class Trial(NamedTuple):
    """A motion and the clip it is scored against: its own, or another one for the floor."""

    truth: Truth
    seen: Seen


def look(skeleton: Skeleton, directions: np.ndarray, fps: float) -> Seen:
    """Wrists, beats and fingers of a motion (T, bones, 3)."""
    wrists = beats.wrists(skeleton, directions)
    return Seen(wrists, beats.motion_beats(wrists, fps), anatomy.finger_flexions(skeleton, directions))


def truth(skeleton: Skeleton, clip: Clip, fps: float) -> Truth:
    """What is known of a clip's motion."""
    strokes = np.array(sorted(stroke.time for stroke in clip.strokes if stroke.kind == "beat"))
    wrists = beats.wrists(skeleton, positions_to_directions(skeleton, clip.positions))
    moves = beats.motion_beats(wrists, fps)
    others = moves[np.abs(moves[:, None] - strokes[None]).min(axis=1, initial=np.inf) > beats.TOLERANCE]
    return Truth(clip, strokes, np.sort(np.concatenate([strokes, others])), len(clip.positions))


def row(trials: Sequence[Trial], fps: float, first_frame: int) -> dict[str, Estimate]:
    """All scores of a row; errors are by clip, those of style by speaker.

    Args:
        trials: motions and clips.
        fps: frames per second of the motions.
        first_frame: frames before it were given to the model and are not scored.
    """
    counts = beat_counts(trials, fps, first_frame)
    clips = np.array([trial.truth.clip.id for trial in trials])
    words = word_shapes(trials, fps, first_frame)
    return {
        "beat_f1": jackknife(counts, beats.f1, clips),
        "beat_f1_strict": jackknife(counts, beats.strict_f1, clips),
        "beat_recall": jackknife(counts, beats.recall, clips),
        "beat_precision": jackknife(counts, beats.precision, clips),
        "beats_per_second": _beat_rate(trials, counts, clips, fps, first_frame),
        "semantic_recall": _over_words(words, lambda pairs: float(np.mean(pairs[:, 0] == pairs[:, 1]))),
        **_style_transfer(trials, fps),
    }


def beat_counts(trials: Sequence[Trial], fps: float, first_frame: int) -> np.ndarray:
    """Rows of `beats.Matches` (trials, 4) of the beat strokes within the time that clip and motion share."""
    counts = []
    for trial in trials:
        start, end = _shared_time(trial, fps, first_frame)
        times = (trial.truth.strokes, trial.truth.causes, trial.seen.beats)
        strokes, causes, moves = (x[(x >= start) & (x < end)] for x in times)
        counts.append(beats.match(strokes, causes, moves))
    return np.array(counts, float).reshape(-1, 4)


def word_shapes(trials: Sequence[Trial], fps: float, first_frame: int) -> list[tuple[str, int, int]]:
    """(clip, class that the hand shows, class of the word) of each gesture-bearing word."""
    words = []
    for trial in trials:
        start, end = _shared_time(trial, fps, first_frame)
        for stroke in trial.truth.clip.strokes:
            if stroke.kind == "semantic" and start <= stroke.time < end:
                hands = trial.seen.flexions[:, _HANDS[stroke.hand]]
                shown = talk.hand_shape(hands, _SHAPES, stroke.time, fps)
                words.append((trial.truth.clip.id, shown, CLASSES.index(stroke.word_class)))
    return words


def semantic_floors(words: Sequence[tuple[str, int, int]]) -> dict[str, dict[str, Estimate]]:
    """Recall of always showing the most frequent class, and of showing the same shapes at shuffled words."""
    true = [word[2] for word in words]
    most = max(set(true), key=true.count) if true else 0
    return {
        "majority": {"semantic_recall": _over_words(words, lambda pairs: float(np.mean(pairs[:, 1] == most)))},
        "shuffled": {"semantic_recall": _over_words(words, lambda pairs: talk.expected_match(*pairs.T))},
    }


def gain(
    own: np.ndarray, mismatched: np.ndarray, clips: Sequence[str], statistic: Callable[[np.ndarray], float] = beats.f1
) -> Estimate:
    """How far a row is above its floor, with the standard error of the paired difference; undefined without a floor.

    Args:
        own: (clips, 4) rows of `beats.Matches`.
        mismatched: (k clips, 4) the same of k motions for other clips, clip by clip.
        clips: (clips,) their ids.
        statistic: `beats.f1` or another one of such rows.
    """
    if not len(mismatched):
        return Estimate(np.nan, np.nan)
    floor = mismatched.reshape(len(own), -1, own.shape[1]).mean(axis=1)
    both = np.stack([own, floor], axis=1)
    return jackknife(both, lambda pair: statistic(pair[:, 0]) - statistic(pair[:, 1]), np.array(clips))


def as_json(estimate: Estimate) -> dict[str, float | None]:
    """The estimate in numbers of JSON, None where it is undefined."""
    return {name: round(x, 4) if np.isfinite(x) else None for name, x in estimate._asdict().items()}


def row_as_json(scores: dict[str, Estimate]) -> dict[str, dict[str, float | None]]:
    """Named estimates in numbers of JSON."""
    return {name: as_json(estimate) for name, estimate in scores.items()}


def _shared_time(trial: Trial, fps: float, first_frame: int) -> tuple[float, float]:
    """Start and end in seconds of what is scored."""
    return first_frame / fps, min(trial.truth.num_frames, len(trial.seen.wrists)) / fps


def _beat_rate(
    trials: Sequence[Trial], counts: np.ndarray, clips: np.ndarray, fps: float, first_frame: int
) -> Estimate:
    spans = [end - start for start, end in (_shared_time(trial, fps, first_frame) for trial in trials)]
    samples = np.stack([counts[:, 2], np.array(spans)], axis=1)
    return jackknife(samples, lambda rows: float(rows[:, 0].sum() / rows[:, 1].sum()), clips)


def _over_words(words: Sequence[tuple[str, int, int]], statistic: Callable[[np.ndarray], float]) -> Estimate:
    pairs = np.array([word[1:] for word in words], int).reshape(-1, 2)
    return jackknife(pairs, statistic, np.array([word[0] for word in words]))


def _style_transfer(trials: Sequence[Trial], fps: float) -> dict[str, Estimate]:
    """Correlation over clips of what is asked for with what is seen."""
    seen = np.array([talk.movement(trial.seen.wrists, fps) for trial in trials])
    asked = np.array([trial.truth.clip.style for trial in trials])
    speakers = np.array([trial.truth.clip.speaker for trial in trials])
    scores = {}
    for index, (name, column) in enumerate((("amplitude", _AMPLITUDE), ("handedness", _HANDEDNESS))):
        pairs = np.stack([seen[:, index], asked[:, column]], axis=1)
        scores[f"style_{name}"] = jackknife(pairs, talk.correlation, speakers)
    return scores
