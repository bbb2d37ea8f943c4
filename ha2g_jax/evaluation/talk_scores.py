"""Score a model on the Talk corpus: compare motions with the strokes, words and styles that are known to cause them.

The tables also have a ceiling and floors.
"""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

from ha2g_jax import anatomy, metrics
from ha2g_jax.data.corpus import TRAIN, Corpus
from ha2g_jax.data.records import Clip
from ha2g_jax.data.talk.speakers import Style
from ha2g_jax.errors import UserError
from ha2g_jax.evaluation import talk_takes
from ha2g_jax.evaluation.clip_result import ClipResult, check_fit, clip_identity, generate_clip, in_threads, sample
from ha2g_jax.evaluation.evaluate import score_as_json
from ha2g_jax.evaluation.talk_takes import MODEL, TEACHER, compare_takes
from ha2g_jax.evaluation.word_probe import MAX_PROBE_CLIPS, probe_words
from ha2g_jax.metrics.beats.strokes import TOLERANCE, match, stroke_beats, wrist_positions
from ha2g_jax.metrics.causes import (
    PROBE_ACCURACY,
    CauseRow,
    expected_match,
    hand_shape,
    movement,
    shown_flexions,
)
from ha2g_jax.metrics.sanity import MEAN_POSE, MISMATCHED
from ha2g_jax.metrics.uncertainty import Estimate, jackknife
from ha2g_jax.progress import progress_bar
from ha2g_jax.skeleton import Skeleton, positions_to_directions
from ha2g_jax.synthesis import Model
from ha2g_jax.synthesis.style import later_seed

WORDLESS, MAJORITY, SHUFFLED = "model, no words", "majority", "shuffled"
CLAIMED = ("beat_f1_gain", "finger_correlation")  # metrics of claims, which are also measured without each speaker
MISMATCHES = 5  # number of motions for other clips from which the floor of a clip is computed

CLASSES = tuple(anatomy.HAND_SHAPES)
_SHAPES = np.array(list(anatomy.HAND_SHAPES.values()))
_HANDS = {"left": [0], "right": [1], "both": [0, 1]}
_STYLE = [Style._fields.index(name) for name in ("amplitude", "handedness")]
_NOTE = "intervals against known causes are 1.96 standard errors by clip, of the style by speaker"


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


def has_known_causes(corpus: Corpus) -> bool:
    """Return whether a corpus knows what caused the motion of its clips, as a Talk corpus does."""
    split = next((name for name in corpus.splits if corpus.has_clips(name)), None)
    return split is not None and bool(corpus.clips(split).fields(0)["style"])


def score_known_causes(
    model: Model,
    corpus: Corpus,
    limits: Mapping[str, int | None],
    seed: int = 0,
    look_ahead: int | None = None,
    by_speaker: Sequence[str] = CLAIMED,
    streams: Mapping[str, Sequence[ClipResult]] = MappingProxyType({}),
) -> dict[str, dict[str, Any]]:
    """Score a model against the strokes, words and styles that cause the motion of a Talk corpus.

    Each split has the rows "model", "model, no words" (for a model that reads words: without the transcript), "teacher"
    (the ceiling: the teacher with other noise), "mean pose", "mismatched speech" (the model's motion for up to
    `MISMATCHES` clips of other recordings), "teacher, one take" (only for takes, see `talk_takes.compare_takes`),
    "majority" and "shuffled" (floors of the hand shapes). Stroke recall is the fraction of the strokes caused by the
    sound that a motion beat matches within 0.1 s; precision is the fraction of the motion beats that match a beat of
    the true motion, whatever its cause. In the strict F1 a motion beat that is caused by a word is wrong. A gain is the
    model's F1 minus that of mismatched speech, with the error of the paired difference. The accuracy of the linear
    probe on frozen f_high is given only for HA2G, if words of the training split have several classes; "majority" has
    that of always choosing the most frequent class.

    The style of each clip is that of its own reference images, or of the speaker's name; `seed` determines seed poses,
    the noise of the teacher and the samples of clips.

    Args:
        limits: name of each split to score -> maximum number of clips, drawn at random; None for all.
        look_ahead: frames of speech that a stream hears beyond each frame; None for motion of whole clips.
        by_speaker: metrics that are also measured without each speaker in turn.
        streams: name of a split -> what `clip_result.generated` returned for it with this limit, seed and look-ahead;
            other splits are generated here. Motion of whole clips cannot be given: it has the first poses of the clips.

    Returns:
        {split: {"rows": {row: {metric: {"value", "low", "high", "error"}}}, "without_speakers": {metric: {speaker:
        value}}, "counts", "notes"}}; the error is a standard error by clip, for the style by speaker, None where
        undefined. The values without a speaker are those of the row "model".

    Raises:
        UserError: there is no such split, or the corpus has no known strokes or another skeleton or frame rate.
    """
    check_fit(model, corpus)
    chosen = {}
    for name, limit in limits.items():
        clips = corpus.clips(name)
        chosen[name] = [clips[index] for index in sample(len(clips), limit, seed)]
        if not all(clip.style for clip in chosen[name]):
            raise UserError(f"{corpus.path} ({name}) does not know its strokes; expected one of `ha2g data make-talk`")
    num_clips = sum(map(len, chosen.values()))
    num_taken = sum(min(talk_takes.MAX_CLIPS, len(clips)) for clips in chosen.values())
    is_probed = model.has_audio_levels and corpus.has_clips(TRAIN)
    num_probed = num_clips + min(MAX_PROBE_CLIPS, len(corpus.clips(TRAIN))) if is_probed else 0
    with progress_bar("scoring against known causes", num_clips + num_taken + num_probed, "clip") as progress:
        results = {
            name: _score_split(model, corpus, clips, seed, look_ahead, by_speaker, streams.get(name), progress)
            for name, clips in chosen.items()
        }
        accuracies = probe_words(model, corpus, chosen, seed, progress) if is_probed else {}
    for name, (own, majority) in accuracies.items():
        for row, predictions in ((MODEL, own), (MAJORITY, majority)):
            accuracy = score_as_json(PROBE_ACCURACY.measure(predictions))
            results[name]["rows"].setdefault(row, {})[PROBE_ACCURACY.name] = accuracy
        if PROBE_ACCURACY.name in by_speaker:
            speakers = {clip.id: clip.speaker for clip in chosen[name]}
            of_words = np.array([speakers[clip] for clip in own.clips.tolist()])
            kept = {speaker: of_words != speaker for speaker in sorted(set(speakers.values()))}
            results[name]["without_speakers"][PROBE_ACCURACY.name] = {
                speaker: float(np.mean(own.is_right[words])) if words.any() else None for speaker, words in kept.items()
            }
    return results


def _score_split(
    model: Model,
    corpus: Corpus,
    clips: Sequence[Clip],
    seed: int,
    look_ahead: int | None,
    by_speaker: Sequence[str],
    streams: Sequence[ClipResult] | None,
    progress: tqdm,
) -> dict[str, Any]:
    skeleton, fps, first_frame = corpus.skeleton, corpus.fps, model.spec.num_seed_frames
    trials: dict[str, list[Trial]] = {name: [] for name in (MODEL, WORDLESS, TEACHER, MEAN_POSE)}

    def add(name: str, truth: Truth, directions: np.ndarray) -> None:
        trials[name].append(Trial(truth, observe(skeleton, directions, fps)))

    def generate(index: int, *, has_words: bool = True) -> np.ndarray:
        clip = clips[index]
        style = clip_identity(model, clip)
        return generate_clip(model, clip, style, later_seed(seed, index), has_words=has_words, look_ahead=look_ahead)

    motions = (stream.directions for stream in streams) if streams else in_threads(generate, range(len(clips)))
    for index, directions in enumerate(motions):
        truth = known_truth(skeleton, clips[index], fps)
        add(MODEL, truth, directions)
        if model.reads_words:
            add(WORDLESS, truth, generate(index, has_words=False))
        add(TEACHER, truth, talk_takes.teach(skeleton, clips[index], [seed, index], fps))
        add(MEAN_POSE, truth, np.broadcast_to(skeleton.mean_directions, directions.shape))
        progress.update()
    made = {name: cause_row(row, fps, first_frame) for name, row in trials.items() if row}
    made |= rows_with_chance(trials[MODEL], fps, first_frame, seed)
    taken = [clips[index] for index in sample(len(clips), talk_takes.MAX_CLIPS, seed)]
    for name, distances in compare_takes(model, taken, seed, look_ahead, progress).items():
        made[name] = made.get(name, CauseRow())._replace(takes=np.array(distances))
    rows = {name: measure_causes(row) for name, row in made.items()}
    own = made.get(MODEL, CauseRow())
    rows |= dict(zip((MAJORITY, SHUFFLED), semantic_floors(own), strict=True))
    return {
        "rows": {name: {key: score_as_json(value) for key, value in row.items()} for name, row in rows.items()},
        "without_speakers": {
            metric: {speaker: _number(value) for speaker, value in without_speakers(own, metric).items()}
            for metric in by_speaker
            if metric != PROBE_ACCURACY.name
        },
        "counts": {
            "clips": len(clips),
            "speakers": len({clip.speaker for clip in clips}),
            "strokes": int(own.counts[:, 0].sum()),
            "words": len(own.shapes),
        },
        "notes": [
            _NOTE,
            f"takes are {talk_takes.MODEL_TAKES} of the model and {talk_takes.TEACHER_TAKES} of the teacher, for "
            f"{len(taken)} clips",
        ],
    }


def _number(value: float) -> float | None:
    return value if np.isfinite(value) else None


def rows_with_chance(trials: Sequence[Trial], fps: float, first_frame: int, seed: int) -> dict[str, CauseRow]:
    """Return the inputs of the metrics of known causes for motions, each with its own clip, and the chance level.

    They are the row "model", which contains the chance level, and the row "mismatched speech": the motions for up to
    `MISMATCHES` clips of other recordings, drawn by the seed, against each clip. A row without trials is left out.
    """
    partners = _partners([trial.truth.clip for trial in trials], seed)
    mismatched = [
        Trial(trial.truth, trials[other].observed)
        for trial, others in zip(trials, partners, strict=True)
        for other in others
    ]
    rows = {MODEL: trials, MISMATCHED: mismatched}
    made = {name: cause_row(row, fps, first_frame) for name, row in rows.items() if row}
    if MISMATCHED in made:
        made[MODEL] = made[MODEL]._replace(mismatched=made[MISMATCHED].counts)
    return made


def _partners(clips: Sequence[Clip], seed: int) -> list[list[int]]:
    """Return for each clip the same number of clips of other recordings, drawn at random."""
    order = np.random.default_rng(seed).permutation(len(clips)).tolist()
    others = []
    for index, clip in enumerate(clips):
        place = order.index(index)
        following = order[place + 1 :] + order[:place]
        others.append([other for other in following if clips[other].recording != clip.recording][:MISMATCHES])
    fewest = min(map(len, others), default=0)
    return [row[:fewest] for row in others]


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
    """Return the inputs of the metrics of known causes, from the first frame that was not given to the model."""
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
        found = metric.measure(row.take(row.speakers != speaker))
        values[speaker] = found.value if isinstance(found, Estimate) else np.nan
    return values


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
    """Return the hand shapes, flexions and clips of a `CauseRow` at the gesture-bearing words."""
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
    """Return start and end in seconds of the scored part."""
    return first_frame / fps, min(trial.truth.num_frames, len(trial.observed.wrists)) / fps
