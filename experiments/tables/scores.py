"""Score the checkpoint of a run, for a table of the paper or at each look-ahead, and store the scores beside it."""

import json
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from ha2g_jax import metrics, synthesis
from ha2g_jax.data.corpus import Corpus
from ha2g_jax.data.records import Clip
from ha2g_jax.errors import UserError
from ha2g_jax.evaluation import evaluate
from ha2g_jax.evaluation.clip_result import (
    ClipResult,
    check_fit,
    clip_identity,
    from_corpus,
    generate_clip,
    split_limits,
    training_motion,
    true,
)
from ha2g_jax.evaluation.features import PoseFeatures
from ha2g_jax.evaluation.rows import Rows, make_rows
from ha2g_jax.evaluation.talk_scores import (
    CLAIMED,
    Trial,
    has_known_causes,
    known_truth,
    measure_causes,
    observe,
    rows_with_chance,
    score_known_causes,
    semantic_floors,
)
from ha2g_jax.files.writing import write_text
from ha2g_jax.metrics import diversity
from ha2g_jax.metrics.beats import stops
from ha2g_jax.metrics.beats.alignment import align, partners, with_partners
from ha2g_jax.metrics.causes import CauseRow
from ha2g_jax.metrics.row import SEED_FRAMES, Row
from ha2g_jax.metrics.uncertainty import Estimate
from ha2g_jax.progress import track
from ha2g_jax.skeleton import positions_to_directions
from ha2g_jax.synthesis import Model
from tables import factorial, hands, look_aheads, retrieval
from tables.look_aheads import ABOVE_FLOOR, BEATS, EVERY, F1, FLOOR, GAIN, HOP, JERK, LOOK_AHEADS, RECALL
from tables.paper_tables import THRESHOLDS
from tables.plan import EVALUATION_VERSION, Plan, Request, TablePlan, scores_path
from tables.tables import MODEL, TRUTH
from tables.workdirs import Run, digest, read_stored

_SEED = 0  # seed of all random draws, so that all rows, runs and look-aheads are scored alike
_TRAINING_CLIPS = 200  # clips whose motion gives the usual changes and limits of angles


def score_run(run: Run, plan: TablePlan, request: Request) -> None:
    """Score the checkpoint of a run on the splits of a plan and store the scores; do nothing where they are stored.

    Raises:
        UserError: the model or the auto-encoder cannot be read, or does not fit the corpus.
    """
    path = scores_path(run, plan, request)
    if path is None or read_stored(path) is not None:
        return
    scores = _score(run, plan, request)
    write_text(path, json.dumps(scores, allow_nan=False) + "\n")


def _score(run: Run, plan: TablePlan, request: Request) -> dict[str, Any]:
    corpus = plan.corpus
    model, features = synthesis.load(run.workdir), PoseFeatures(plan.autoencoder.workdir)
    training = training_motion(corpus, limit=_TRAINING_CLIPS)
    retrieved = _retrieve(plan, request)
    pairs, axes = {}, hands.principal_axes(corpus.skeleton, training) if request.table == factorial.TABLE else None
    scores: dict[str, Any] = {"model": model.assets.hash, "autoencoder": features.id, "splits": {}}
    for split in plan.splits:
        motions, truth = pairs[split] = from_corpus(model, corpus, split, seed=_SEED, with_audio=request.has_legacy)
        found = evaluate.evaluate(
            {MODEL: motions, retrieval.NAME: retrieved[split]},
            truth,
            corpus.skeleton,
            training=training,
            autoencoder=features,
            legacy=request.has_legacy,
            seed=_SEED,
            draws=plan.draws,
        )
        rows = make_rows({MODEL: motions}, truth, corpus.skeleton, training=training, autoencoder=features, seed=_SEED)
        scores["splits"][split] = {
            "evaluation": found,
            "draws": _draws(rows),
            "sweep": _sweep(rows),
        }
    if request.data == "talk":
        by_speaker = factorial.MEASURED if request.table == factorial.TABLE else CLAIMED
        known = score_known_causes(model, corpus, split_limits(corpus, plan.splits), _SEED, by_speaker=by_speaker)
        for split in plan.splits:
            motion = {clip.id: clip.directions for clip in retrieved[split]}
            known[split]["rows"][retrieval.NAME] = _known_causes(corpus, split, motion)
            if axes is not None:
                _add_hands(known[split], corpus, split, axes, *pairs[split])
            scores["splits"][split]["talk"] = known[split]
    return scores


def _add_hands(
    known: dict[str, Any],
    corpus: Corpus,
    split: str,
    axes: np.ndarray,
    motions: Sequence[ClipResult],
    truth: Sequence[ClipResult],
) -> None:
    """Add the FGD of the hands of a split's motions to the scores against known causes."""
    clips = corpus.clips(split)
    speakers = [clips.fields(index)["speaker"] for index in range(len(clips))]
    own, true = ([clip.directions for clip in side] for side in (motions, truth))
    value, without = hands.hands_fgd(corpus.skeleton, axes, own, true, speakers)
    known["rows"][MODEL][factorial.HANDS_FGD] = {"value": _value(value), "low": None, "high": None}
    known["without_speakers"][factorial.HANDS_FGD] = {name: _value(each) for name, each in without.items()}


def _known_causes(corpus: Corpus, split: str, motion: dict[str, np.ndarray]) -> dict[str, Any]:
    """Return the scores of direction vectors (T, bones, 3), by the id of the clip, against known causes."""
    clips = [clip for clip in corpus.clips(split) if clip.id in motion]
    row = _causes(corpus, clips, [motion[clip.id] for clip in clips], SEED_FRAMES)
    return {key: evaluate.score_as_json(value) for key, value in measure_causes(row).items()}


def _retrieve(plan: TablePlan, request: Request) -> dict[str, list[ClipResult]]:
    """Return the motion that is retrieved for the clips of each split; what was found is stored for the other runs."""
    corpus, causes = plan.corpus, [EVALUATION_VERSION, list(plan.splits), plan.digest]
    path = request.workdir / f"retrieval-{digest(causes)}.json"
    nearest = read_stored(path)
    if nearest is None:
        library = retrieval.make_library(corpus)
        nearest = {split: retrieval.nearest_windows(library, corpus, split) for split in plan.splits}
        write_text(path, json.dumps(nearest) + "\n")
    return {split: retrieval.join_motion(corpus, split, nearest[split]) for split in plan.splits}


def _draws(rows: Rows) -> dict[str, list[float | None]]:
    """Return diversity (L1) of the model and of ground truth in ten random draws of pairs (Table 12)."""
    found = {name: diversity.row_draws(rows.rows[name]) for name in (MODEL, TRUTH)}
    return {
        name: [] if draws is None or np.isnan(draws.l1).any() else _numbers(draws.l1) for name, draws in found.items()
    }


def _sweep(rows: Rows) -> dict[str, dict[str, list[float | None]]]:
    """Return the curves of Figure 3 of the model and of ground truth."""
    reference = rows.reference
    change = stops.mean_angle_change(reference.skeleton, reference.training)

    def curves(row: Row) -> dict[str, list[float | None]]:
        sounds = {number: onsets for number, onsets in enumerate(row.onsets) if onsets is not None}
        rates = stops.angle_change_rates(reference.skeleton, [row.directions[number] for number in sounds], change)
        recordings = reference.recordings[row.numbers[list(sounds)]]
        found = sweep(rates, list(sounds.values()), recordings, reference.fps)
        return {name: _numbers(values) for name, values in found.items()}

    return {name: curves(rows.rows[name]) for name in (MODEL, TRUTH)}


def sweep(
    rates: Sequence[np.ndarray], onsets: Sequence[np.ndarray], recordings: np.ndarray, fps: float
) -> dict[str, np.ndarray]:
    """Compute BC, and F with the own and with mismatched speech, of clips for each threshold of Figure 3.

    The arguments are those of `stops.make_clips` and `alignment.mismatched`; the other clips, whose speech is
    mismatched, are the same for all thresholds. F is the mean over the clips that are not silent.
    """
    others, curves = None, {"consistency": [], "own": [], "mismatched": []}
    for threshold in THRESHOLDS:
        clips = stops.make_clips(rates, onsets, fps, threshold=threshold)
        others = partners(clips, recordings, seed=_SEED) if others is None else others
        own = align(clips)
        curves["consistency"].append(stops.beat_consistency(stops.consistency(rates, onsets, fps, threshold=threshold)))
        curves["own"].append(_mean(own.f))
        curves["mismatched"].append(_mean(np.where(own.is_silent, np.nan, with_partners(clips, others))))
    return {name: np.array(values) for name, values in curves.items()}


def _mean(values: np.ndarray) -> float:
    """Return the mean of the values that are not NaN; NaN without any."""
    there = values[~np.isnan(values)]
    return float(there.mean()) if len(there) else np.nan


def _numbers(values: np.ndarray) -> list[float | None]:
    return [float(f"{value:.6g}") if math.isfinite(value) else None for value in values.tolist()]


def score_look_aheads(run: Run, plan: Plan, split: str) -> None:
    """Score the checkpoint of a run at all look-aheads, and store each as it is made; stored ones are not made again.

    A file has {"model", "recordings", "model_scores", "truth_scores"}; scores are {name: {"value", "without"}}, where
    "without" has the score without each recording in turn.

    Raises:
        UserError: the model cannot be read or does not fit the corpus, or the causes of its gestures are not known.
    """
    paths = {look_ahead: look_aheads.scores_path(run, plan, split, look_ahead) for look_ahead in LOOK_AHEADS}
    missing = {look_ahead: path for look_ahead, path in paths.items() if path and read_stored(path) is None}
    if not missing:
        return
    corpus, model = plan.corpus, synthesis.load(run.workdir)
    check_fit(model, corpus)
    if not has_known_causes(corpus):
        raise UserError(f"{corpus.path} does not know the causes of its gestures; give a Talk corpus")
    clips = corpus.clips(split)[::EVERY]
    training = training_motion(corpus, limit=_TRAINING_CLIPS)
    truth = true(corpus, split)[::EVERY]
    performed = [positions_to_directions(corpus.skeleton, clip.positions) for clip in clips]
    known = _causes(corpus, clips, performed, model.spec.num_seed_frames)
    for look_ahead, path in missing.items():
        motions = _generate(model, clips, look_ahead)
        causes = _causes(corpus, clips, motions, model.spec.num_seed_frames)
        results = [
            ClipResult(clip.id, clip.recording or clip.id, directions, corpus.fps)
            for clip, directions in zip(clips, motions, strict=True)
        ]
        rows = make_rows({MODEL: results}, truth, corpus.skeleton, training=training, seed=_SEED)
        recordings = [clip.recording or clip.id for clip in clips]
        scores = {
            "model": model.assets.hash,
            "recordings": sorted(set(recordings)),
            "model_scores": leave_one_out(causes, recordings) | _of_motion(rows.rows[MODEL]),
            "truth_scores": leave_one_out(known, recordings) | _of_motion(rows.truth),
        }
        write_text(path, json.dumps(scores, indent=1, allow_nan=False) + "\n")


def leave_one_out(row: CauseRow, recordings: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Return the scores of `known_scores`, of all clips and without each recording in turn.

    Args:
        row: measurements of one motion of each clip, with the chance level.

    Returns:
        {name: {"value", "without": a number for each recording in ascending order}}.
    """
    parts = [known_scores(row.take(np.not_equal(recordings, name))) for name in sorted(set(recordings))]
    return {
        name: {"value": value, "without": [part[name] for part in parts]} for name, value in known_scores(row).items()
    }


def known_scores(row: CauseRow) -> dict[str, float | None]:
    """Return the scores against known causes, None where undefined.

    The semantic floor is the better of always showing the most frequent class and of showing the same shapes at
    shuffled words.
    """
    found = {name: _value(metrics.lookup(name).measure(row)) for name in (F1, GAIN, RECALL)}
    floors = [_value(floor[RECALL]) for floor in semantic_floors(row)] if len(row.shapes) else []
    floor = max((value for value in floors if value is not None), default=None)
    recall = found[RECALL]
    above = None if floor is None or recall is None else recall - floor
    return found | {FLOOR: floor, ABOVE_FLOOR: above}


def _generate(model: Model, clips: Sequence[Clip], look_ahead: int | None) -> list[np.ndarray]:
    name = f"look-ahead {look_aheads.title(look_ahead)}"
    return [
        generate_clip(model, clip, clip_identity(model, clip), _SEED + index, look_ahead=look_ahead, hop=HOP)
        for index, clip in enumerate(track(clips, name, "clip"))
    ]


def _causes(corpus: Corpus, clips: Sequence[Clip], motions: Sequence[np.ndarray], first_frame: int) -> CauseRow:
    skeleton, fps = corpus.skeleton, corpus.fps
    trials = [
        Trial(known_truth(skeleton, clip, fps), observe(skeleton, directions, fps))
        for clip, directions in zip(clips, motions, strict=True)
    ]
    return rows_with_chance(trials, fps, first_frame, _SEED)[MODEL]


def _of_motion(row: Row) -> dict[str, dict[str, Any]]:
    """Return jerk and beats per second, which are functions of how often each recording is drawn."""
    found = {}
    for name in (JERK, BEATS):
        statistic = metrics.lookup(name).measure(row)
        if callable(statistic):
            every = np.ones(row.reference.num_recordings)
            without = [_value(statistic(every - one)) for one in np.eye(len(every))]
            found[name] = {"value": _value(statistic(every)), "without": without}
    return found


def _value(score: Any) -> float | None:
    value = score.value if isinstance(score, Estimate) else score
    return float(value) if value is not None and np.isfinite(value) else None
