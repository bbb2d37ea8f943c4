"""Scores of one run of a table: those of `study.evaluation`, draws of diversity, the sweep of Figure 3, and Talk's."""

import json
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from ha2g_jax import synthesis
from ha2g_jax.data.corpus import TRAIN, Corpus
from ha2g_jax.files.whole_file import whole_file
from ha2g_jax.metrics import beat_alignment
from ha2g_jax.skeleton import Skeleton
from ha2g_jax.study.evaluation import evaluate
from ha2g_jax.study.evaluation.features import PoseFeatures
from ha2g_jax.study.evaluation.latent_statistics import choose_cut, diversity_draws, encode
from ha2g_jax.study.evaluation.performance import SEED_FRAMES, from_corpus, training_motion
from ha2g_jax.study.evaluation.rows import Row, Rows, make_rows
from ha2g_jax.study.reproduction.plan import Plan, Request, Run, read_scores, scores_path
from ha2g_jax.study.reproduction.run_estimates import MODEL, TRUTH
from ha2g_jax.study.talk.evaluate import score

_SEED = 0  # seed of all random draws of an evaluation, so that all rows and runs are scored alike
_TRAINING_CLIPS = 200  # clips from which the mean changes and limits of angles are computed


def score_run(run: Run, plan: Plan, request: Request) -> None:
    """Score the checkpoint of a run on the splits of a plan and store the scores, unless they are stored already.

    Args:
        run: run to score.
        plan: plan of the table.
        request: request of the user.

    Raises:
        UserError: the model or the auto-encoder cannot be read, or does not fit the corpus.
    """
    path = scores_path(run, plan, request.has_legacy)
    if path is None or read_scores(path) is not None:
        return
    scores = _score(run, plan, request)
    with whole_file(path) as temporary:
        temporary.write_text(json.dumps(scores, indent=1, allow_nan=False) + "\n")


def _score(run: Run, plan: Plan, request: Request) -> dict[str, Any]:
    corpus = Corpus.open(plan.corpus)
    model, features = synthesis.load(run.workdir), PoseFeatures(plan.autoencoder.workdir)
    training = training_motion(corpus, TRAIN, limit=_TRAINING_CLIPS)
    scores: dict[str, Any] = {"model": model.assets.hash, "autoencoder": features.id, "splits": {}}
    for split in plan.splits:
        motions, truth = from_corpus(model, corpus, split, seed=_SEED, with_audio=request.has_legacy)
        found = evaluate.evaluate(
            {MODEL: motions},
            truth,
            corpus.skeleton,
            training=training,
            autoencoder=features,
            legacy=request.has_legacy,
            seed=_SEED,
            draws=plan.draws,
        )
        rows = make_rows({MODEL: motions}, truth, corpus.skeleton.mean_directions, _SEED)
        scores["splits"][split] = {
            "evaluation": found,
            "draws": _draws(rows, features),
            "sweep": _sweep(rows, corpus.skeleton, training, corpus.fps),
        }
    if request.data == "talk":
        known = score(model, corpus, plan.splits, _SEED)
        for split in plan.splits:
            scores["splits"][split]["talk"] = known["splits"][split]
        scores["probe"] = known["probe"]
    return scores


def _draws(rows: Rows, features: PoseFeatures) -> dict[str, list[float | None]]:
    """Return the diversity (L1) of the model and of ground truth in ten random draws of pairs (Table 12)."""
    cut = choose_cut([len(directions) for directions in rows.truth.directions])
    if cut is None:
        return {MODEL: [], TRUTH: []}
    latents = {name: encode(rows.rows[name], rows.members, cut, features) for name in (MODEL, TRUTH)}
    return {name: _numbers(diversity_draws(own, _SEED).l1) for name, own in latents.items()}


def _sweep(
    rows: Rows, skeleton: Skeleton, training: Sequence[np.ndarray], fps: float
) -> dict[str, dict[str, list[float | None]]]:
    """Return F of the model and of ground truth for their own and for mismatched speech, by threshold (Figure 3)."""
    change = beat_alignment.mean_angle_change(skeleton, training)

    def sweep(row: Row) -> dict[str, list[float | None]]:
        heard = {number: onsets for number, onsets in enumerate(row.onsets) if onsets is not None}
        rates = beat_alignment.angle_change_rates(skeleton, [row.directions[number] for number in heard], change)
        found = beat_alignment.sweep(
            rates,
            list(heard.values()),
            rows.sources[row.numbers[list(heard)]],
            fps,
            first_frame=SEED_FRAMES,
            seed=_SEED,
        )
        return {"own": _numbers(found.own), "mismatched": _numbers(found.mismatched)}

    return {name: sweep(rows.rows[name]) for name in (MODEL, TRUTH)}


def _numbers(values: np.ndarray) -> list[float | None]:
    return [float(f"{value:.6g}") if math.isfinite(value) else None for value in values.tolist()]
