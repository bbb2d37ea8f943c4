"""All scores of one run of a table, stored beside the run: `evaluation`, draws, the sweep, known causes."""

import json
import math
from typing import Any

import numpy as np

from ha2g_jax import synthesis
from ha2g_jax.data.corpus import TRAIN, Corpus
from ha2g_jax.errors import UserError
from ha2g_jax.evaluation import evaluate, retrieval
from ha2g_jax.evaluation.clip_result import ClipResult, from_corpus, split_limits, training_motion
from ha2g_jax.evaluation.features import PoseFeatures
from ha2g_jax.evaluation.rows import Rows, make_rows
from ha2g_jax.evaluation.talk.known_causes import score_known_causes, score_motion
from ha2g_jax.files.writing import whole_file
from ha2g_jax.metrics import diversity
from ha2g_jax.metrics.beats import stops, summary
from ha2g_jax.metrics.row import SEED_FRAMES, Row
from tables.plan import Plan, Run, is_copy, read_stored, retrieval_path, scores_path
from tables.request import Request
from tables.run_estimates import MODEL, TRUTH

_SEED = 0  # seed of all random draws of an evaluation, so that all rows and runs are scored alike
_TRAINING_CLIPS = 200  # clips from which the mean changes and limits of angles are computed


def score_run(run: Run, plan: Plan, request: Request) -> None:
    """Score the checkpoint of a run on the splits of a plan and store the scores; do nothing where they are stored.

    Raises:
        UserError: the model or the auto-encoder cannot be read, or does not fit the corpus, or the run is a copy.
    """
    path = scores_path(run, plan, request.has_legacy)
    if path is None or read_stored(path) is not None:
        return
    if is_copy(run):
        raise UserError(f"{run.name} is a copy without weights, and has no scores of this kind; remove it to train it")
    scores = _score(run, plan, request)
    with whole_file(path) as temporary:
        temporary.write_text(json.dumps(scores, allow_nan=False) + "\n")


def _score(run: Run, plan: Plan, request: Request) -> dict[str, Any]:
    corpus = Corpus.open(plan.corpus)
    model, features = synthesis.load(run.workdir), PoseFeatures(plan.autoencoder.workdir)
    training = training_motion(corpus, TRAIN, limit=_TRAINING_CLIPS)
    retrieved = _retrieve(plan, corpus)
    scores: dict[str, Any] = {"model": model.assets.hash, "autoencoder": features.id, "splits": {}}
    for split in plan.splits:
        motions, truth = from_corpus(model, corpus, split, seed=_SEED, with_audio=request.has_legacy)
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
        known = score_known_causes(model, corpus, split_limits(corpus, plan.splits), _SEED)
        for split in plan.splits:
            motion = {clip.id: clip.directions for clip in retrieved[split]}
            known[split]["rows"][retrieval.NAME] = score_motion(corpus, split, motion, _SEED)
            scores["splits"][split]["talk"] = known[split]
    return scores


def _retrieve(plan: Plan, corpus: Corpus) -> dict[str, list[ClipResult]]:
    """Return the motion that is retrieved for the clips of each split; what was found is stored for the other runs."""
    path = retrieval_path(plan)
    nearest = read_stored(path)
    if nearest is None:
        library = retrieval.make_library(corpus)
        nearest = {split: retrieval.nearest_windows(library, corpus, split) for split in plan.splits}
        with whole_file(path) as temporary:
            temporary.write_text(json.dumps(nearest) + "\n")
    return {split: retrieval.join_motion(corpus, split, nearest[split]) for split in plan.splits}


def _draws(rows: Rows) -> dict[str, list[float | None]]:
    """Return diversity (L1) of the model and of ground truth in ten random draws of pairs (Table 12)."""
    found = {name: diversity.row_draws(rows.rows[name]) for name in (MODEL, TRUTH)}
    return {name: [] if draws is None else _numbers(draws.l1) for name, draws in found.items()}


def _sweep(rows: Rows) -> dict[str, dict[str, list[float | None]]]:
    """Return BC of the model and of ground truth, and F with the own and with mismatched speech, by threshold."""
    reference = rows.reference
    change = stops.mean_angle_change(reference.skeleton, reference.training)

    def sweep(row: Row) -> dict[str, list[float | None]]:
        sounds = {number: onsets for number, onsets in enumerate(row.onsets) if onsets is not None}
        rates = stops.angle_change_rates(reference.skeleton, [row.directions[number] for number in sounds], change)
        found = summary.sweep(
            rates,
            list(sounds.values()),
            reference.recordings[row.numbers[list(sounds)]],
            reference.fps,
            first_frame=SEED_FRAMES,
            seed=_SEED,
        )
        curves = {"consistency": found.consistency, "own": found.own, "mismatched": found.mismatched}
        return {name: _numbers(values) for name, values in curves.items()}

    return {name: sweep(rows.rows[name]) for name in (MODEL, TRUTH)}


def _numbers(values: np.ndarray) -> list[float | None]:
    return [float(f"{value:.6g}") if math.isfinite(value) else None for value in values.tolist()]
