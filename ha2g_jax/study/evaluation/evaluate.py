"""Scores of any motion against reference motion, with intervals, beside rows that show what each score is worth."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import threadpoolctl
from tqdm import tqdm

from ha2g_jax import __version__
from ha2g_jax.errors import UserError
from ha2g_jax.metrics import beat_align, beat_alignment, kinematics, srgr
from ha2g_jax.skeleton import Skeleton
from ha2g_jax.study.evaluation import row_statistics
from ha2g_jax.study.evaluation.flags import flags
from ha2g_jax.study.evaluation.intervals import DRAWS, LEVEL, Intervals, number, spread
from ha2g_jax.study.evaluation.latent_statistics import NUM_HALVES, Statistic
from ha2g_jax.study.evaluation.latents import check_autoencoder, score_latents
from ha2g_jax.study.evaluation.legacy import legacy_scores
from ha2g_jax.study.evaluation.metrics import FGD, FGD_SEEDED, HALF, METRICS, SANITY_ROWS, TRUTH
from ha2g_jax.study.evaluation.performance import SEED_FRAMES, Performance
from ha2g_jax.study.evaluation.row_statistics import RowScores
from ha2g_jax.study.evaluation.rows import Rows, make_rows

if TYPE_CHECKING:  # JAX takes seconds to import, and an evaluation without latents does without
    from ha2g_jax.study.evaluation.features import PoseFeatures

# Metrics of which the difference between two methods is given.
_PAIRED = (
    *("beat_gain", "beat_f", FGD, FGD_SEEDED, "diversity_l1", "l1_diversity", "speed_hellinger", "acceleration"),
    *("jerk", "joint_mae", "pck"),
)


# A bootstrap decomposes thousands of small matrices, at which the threads of a linear algebra library only wait for
# each other: on a busy machine that took ten times as long.
@threadpoolctl.threadpool_limits.wrap(limits=1)
def evaluate(
    rows: Mapping[str, Sequence[Performance]],
    reference: Sequence[Performance],
    skeleton: Skeleton,
    *,
    training: Sequence[np.ndarray] | None = None,
    autoencoder: "PoseFeatures | None" = None,
    legacy: bool = False,
    seed: int = 0,
    draws: int = DRAWS,
    notes: Sequence[str] = (),
) -> dict[str, Any]:
    """All scores of methods on the same clips; `table` prints them.

    The rows of `metrics.SANITY_ROWS` are always there. An interval is the 95 % percentile interval under
    resampling of the sources; the same sources are drawn for all rows.

    Args:
        rows: performances of each method. A clip may have several, such as those of several seeds.
        reference: the true motion, one performance of a clip, with its onsets.
        skeleton: of all motion; its constants serve the legacy scores.
        training: clips (T, bones, 3) of the training split, from which the mean pose, usual changes of angles and
            limits of angles are taken; by default the reference itself.
        autoencoder: gives the latents of FGD and diversity, which are left out without.
        legacy: whether to add the section "legacy_v1"; for beat consistency the reference needs its audio.
        seed: of everything random.
        draws: of the bootstrap.
        notes: sentences about the motion, to be kept with the results.

    Returns:
        Ready for JSON: "rows": {row: {metric: {"value", "low", "high"}}}, None where undefined, diversity with "sd"
        over ten draws; "differences": {"METHOD - FIRST METHOD": the same of paired differences}; "counts": of clips and
        rates, by row; "data", "settings", "autoencoder" (None without), "flags", "warnings" and "notes"; "legacy_v1"
        on demand.

    Raises:
        UserError: no method, no clip that all have, or an auto-encoder of another skeleton or frame rate.
    """
    if not rows or not reference:
        raise UserError("nothing to evaluate; give the motion of at least one method and of the reference")
    fps = reference[0].fps
    check_autoencoder(autoencoder, skeleton, fps)
    clips = [clip.directions for clip in reference] if training is None else training
    made = make_rows(rows, reference, row_statistics.mean_directions(clips), seed)
    yardstick = row_statistics.make_yardstick(skeleton, clips, made.truth.directions, fps, seed)
    num_steps = len(made.rows) * (2 if autoencoder is None else 3)
    with tqdm(desc="evaluate", total=num_steps, unit="row", disable=None, leave=False) as progress:
        scores: dict[str, RowScores] = {}
        for name, row in made.rows.items():
            scores[name] = row_statistics.measure(row, made.truth, made, yardstick)
            progress.update()
        latents = score_latents(made, autoencoder, seed, progress.update)
        statistics = {name: _beside_truth(scores[name], scores[TRUTH]) for name in made.rows}
        for name, found in latents.statistics.items():
            statistics[name] |= found
        intervals = Intervals(made.num_sources, draws, seed)
        results: dict[str, dict[str, dict[str, float | None]]] = {name: {} for name in (*rows, *SANITY_ROWS)}
        for name, own in statistics.items():
            drawn = latents.draws.get(name, {})
            results[name] = {key: intervals(own[key]) | drawn.get(key, {}) for key in METRICS if key in own}
            progress.update()
    results[HALF] = _halves(made, scores[TRUTH].speed_counts, latents.halves, seed)
    return {
        "version": __version__,
        "methods": list(rows),
        "rows": results,
        "differences": _differences({name: statistics[name] for name in rows}, intervals),
        "counts": {name: {key: number(value) for key, value in score.counts.items()} for name, score in scores.items()},
        "data": {
            "clips": len(made.ids),
            "sources": made.num_sources,
            "seconds": round(sum(map(len, made.truth.directions)) / fps, 2),
            "windows": latents.windows,
            "skeleton": skeleton.name,
            "fps": fps,
        },
        "settings": _settings(seed, draws, fps, has_training=training is not None),
        "autoencoder": latents.autoencoder,
        "flags": flags(results, list(rows)),
        "warnings": [*_few_sources(made), *latents.warnings],
        "notes": [*notes, *made.notes, *_silence(made), *latents.notes],
        **({"legacy_v1": legacy_scores(made, skeleton, autoencoder, seed=seed)} if legacy else {}),
    }


def _beside_truth(own: RowScores, truth: RowScores) -> dict[str, Statistic]:
    """The statistics of a row with those that relate it to ground truth."""
    ratios = {
        f"{metric}_ratio": row_statistics.ratio(own.statistics[metric], truth.statistics[metric])
        for metric in ("acceleration", "jerk")
        if metric in own.statistics and metric in truth.statistics
    }
    speeds = row_statistics.speed_distance(own.speed_counts, truth.speed_counts)
    return own.statistics | ratios | {"speed_hellinger": speeds}


def _differences(
    statistics: Mapping[str, Mapping[str, Statistic]], intervals: Intervals
) -> dict[str, dict[str, dict[str, float | None]]]:
    """Of every further method less the first one."""
    (first, base), *others = statistics.items()
    return {
        f"{name} - {first}": {
            key: intervals(row_statistics.difference(own[key], base[key]))
            for key in _PAIRED
            if key in own and key in base
        }
        for name, own in others
    }


def _halves(
    made: Rows, speed_counts: np.ndarray, distances: Mapping[str, np.ndarray], seed: int
) -> dict[str, dict[str, float | None]]:
    """Ground truth's one half against the other, over random halves of the sources."""
    if made.num_sources < 2:
        return {}
    rng = np.random.default_rng(seed)
    speeds = []
    for _ in range(NUM_HALVES):
        is_first = np.zeros(made.num_sources)
        is_first[rng.permutation(made.num_sources)[: made.num_sources // 2]] = 1
        sides = (np.tensordot(side, speed_counts, axes=1) for side in (is_first, 1 - is_first))
        speeds.append(kinematics.histogram_distance(*sides))
    found = {**distances, "speed_hellinger": np.array(speeds)}
    return {name: spread(found[name]) for name in METRICS if name in found}


def _few_sources(made: Rows) -> list[str]:
    if made.num_sources > 1:
        return []
    return [
        "all clips are of one source, so there are no intervals, no mismatched speech and no other half; give clips of "
        "several recordings"
    ]


def _silence(made: Rows) -> list[str]:
    missing = [name for name, onsets in zip(made.ids, made.truth.onsets, strict=True) if onsets is None]
    if not missing:
        return []
    return [
        f"{len(missing)} of {len(made.ids)} clips have no sound, such as {missing[0]}, so their beats are not scored; "
        "put a file of sound with the name of the clip beside its reference"
    ]


def _settings(seed: int, draws: int, fps: float, *, has_training: bool) -> dict[str, Any]:
    """What the numbers depend on beside the motion."""
    return {
        "first_frame": SEED_FRAMES,
        "seed": seed,
        "draws": draws,
        "level": LEVEL,
        "usual_motion": "training" if has_training else "reference",
        "beat_alignment": {
            "sigma": beat_alignment.SIGMA,
            "threshold": beat_alignment.THRESHOLD,
            "silence_db": beat_alignment.SILENCE_DB,
            "mismatches": row_statistics.NUM_MISMATCHES,
        },
        "beat_align": {
            "sigma": beat_align.SIGMA,
            "threshold": beat_align.THRESHOLD,
            "order": beat_align.order(fps),
        },
        "pck_delta": srgr.DELTA,
    }
