"""Scores of any motion against reference motion, with intervals, beside rows that show what each score is worth."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import threadpoolctl
from tqdm import tqdm

from ha2g_jax import metrics
from ha2g_jax.errors import UserError
from ha2g_jax.evaluation import latents
from ha2g_jax.evaluation.clip_result import ClipResult
from ha2g_jax.evaluation.flags import flags
from ha2g_jax.evaluation.intervals import DRAWS, LEVEL, Intervals, number, spread
from ha2g_jax.evaluation.rows import Rows, make_rows
from ha2g_jax.metrics import reconstruction
from ha2g_jax.metrics.beats import rests, stops, summary, times
from ha2g_jax.metrics.legacy import legacy_notes
from ha2g_jax.metrics.metric import Score, Section, Statistic
from ha2g_jax.metrics.row import SEED_FRAMES, Row
from ha2g_jax.metrics.sanity import HALF, SANITY_ROWS
from ha2g_jax.skeleton import Skeleton

if TYPE_CHECKING:  # JAX takes seconds to import, and an evaluation without latents does without
    from ha2g_jax.evaluation.features import PoseFeatures

Scores = dict[str, Score]  # name of a metric -> its score in one row


# A bootstrap decomposes thousands of small matrices, at which the threads of a linear algebra library only wait for
# each other: on a busy machine that took ten times as long.
@threadpoolctl.threadpool_limits.wrap(limits=1)
def evaluate(
    rows: Mapping[str, Sequence[ClipResult]],
    reference: Sequence[ClipResult],
    skeleton: Skeleton,
    *,
    training: Sequence[np.ndarray] | None = None,
    autoencoder: "PoseFeatures | None" = None,
    legacy: bool = False,
    seed: int = 0,
    draws: int = DRAWS,
    notes: Sequence[str] = (),
) -> dict[str, Any]:
    """Measure all registered metrics of methods on the same clips; `table` prints them.

    The rows of `sanity.SANITY_ROWS` are always there. An interval is the 95 % percentile interval under resampling of
    the recordings; the same recordings are drawn for all rows.

    Args:
        rows: clip results of each method. A clip may have several, such as those of several seeds.
        reference: true motion, one clip result for each clip, with onsets.
        skeleton: skeleton of all motion, whose constants serve the legacy scores.
        training: clips (T, bones, 3) of the training split, from which the mean pose and reference statistics (usual
            changes of angles, limits of angles) are taken; by default the reference itself.
        autoencoder: pose auto-encoder that gives the latents of FGD and diversity, which are left out without.
        legacy: whether to add the section "legacy_v1"; beat consistency then needs the sound of the reference.
        seed: seed of everything random.
        draws: number of draws of the bootstrap.
        notes: sentences about the motion, to be kept with the results.

    Returns:
        One section of results, ready for JSON: "rows": {row: {metric: {"value", "low", "high"}}}, None where undefined,
        diversity with "sd" over ten draws; "differences": {"METHOD - FIRST METHOD": the same of paired differences};
        "counts": counts of clips and rates, by row; "methods", "data", "settings", "autoencoder" (None without),
        "flags", "warnings" and "notes"; "legacy_v1" on demand.

    Raises:
        UserError: no method, no clip that all have, or an auto-encoder of another skeleton or frame rate.
    """
    if not rows or not reference:
        raise UserError("nothing to evaluate; give the motion of at least one method and of the reference")
    latents.check_autoencoder(autoencoder, skeleton, reference[0].fps)
    made = make_rows(rows, reference, skeleton, training=training, autoencoder=autoencoder, seed=seed)
    intervals = Intervals(made.reference.num_recordings, draws, seed)
    found, scores = _measure_rows(made, intervals, has_legacy=legacy)
    results: dict[str, dict[str, Any]] = {name: {} for name in (*rows, *SANITY_ROWS)} | found["rows"]
    results[HALF] = _halves(made.truth)
    section = {
        "methods": list(rows),
        "rows": results,
        "differences": _differences({name: scores[name] for name in rows}, intervals),
        "counts": found["counts"],
        "data": {
            "clips": len(made.ids),
            "recordings": made.reference.num_recordings,
            "seconds": round(sum(map(len, made.truth.directions)) / made.reference.fps, 2),
            "windows": latents.count_windows(made.truth),
            "skeleton": skeleton.name,
            "fps": made.reference.fps,
        },
        "settings": _settings(seed, draws, made.reference.fps, has_training=training is not None),
        "autoencoder": latents.describe(made.truth, autoencoder),
        "flags": flags(results, list(rows)),
        "warnings": [*_few_recordings(made), *latents.warnings(made.truth, autoencoder)],
        "notes": [*notes, *made.notes, *_silence(made), *latents.notes(made.truth, autoencoder)],
    }
    if legacy:
        section["legacy_v1"] = {"rows": found["legacy_v1"], "notes": legacy_notes(made.truth)}
    return section


def _measure_rows(made: Rows, intervals: Intervals, *, has_legacy: bool) -> tuple[dict[str, Any], dict[str, Scores]]:
    """Return scores with intervals by section and row, the counts by row, and the scores of "rows" themselves."""
    found: dict[str, Any] = {"rows": {}, "legacy_v1": {}, "counts": {}}
    scores = {}
    with tqdm(desc="evaluate", total=len(made.rows), unit="row", disable=None, leave=False) as progress:
        for name, row in made.rows.items():
            scores[name] = measure(row, "rows")
            found["rows"][name] = {key: intervals(score) for key, score in scores[name].items()}
            found["rows"][name] |= _draws(row, found["rows"][name])
            found["counts"][name] = {key: number(value) for key, value in row.once(summary.clip_counts).items()}
            if has_legacy:
                found["legacy_v1"][name] = {key: intervals(score) for key, score in measure(row, "legacy_v1").items()}
            if row is not made.truth:
                row.forget()
            progress.update()
    return found, scores


def measure(row: Any, section: Section) -> Scores:
    """Measure the metrics of a section of which a row has a score, in the order of the columns."""
    scores = {name: metric.measure(row) for name, metric in metrics.of_section(section).items()}
    return {name: score for name, score in scores.items() if score is not None}


def _draws(row: Row, scores: Mapping[str, Any]) -> dict[str, dict[str, float | None]]:
    """Return the scores whose value is the mean of random draws, with their standard deviation."""
    found = {}
    for name, score in scores.items():
        draws = metrics.lookup(name).draws
        values = draws(row) if draws else None
        if values is not None:
            found[name] = score | {"value": number(values.mean()), "sd": number(values.std(ddof=1))}
    return found


def _differences(scores: Mapping[str, Scores], intervals: Intervals) -> dict[str, dict[str, dict[str, float | None]]]:
    """Return the paired differences of every further method less the first one."""
    (first, base), *others = scores.items()
    paired = [name for name, metric in metrics.of_section("rows").items() if metric.is_paired]
    return {
        f"{name} - {first}": {
            key: intervals.of_statistic(_difference(own[key], base[key]))
            for key in paired
            if key in own and key in base
        }
        for name, own in others
    }


def _difference(first: Score, second: Score) -> Statistic:
    """Return one score less another of the same draw."""
    if not callable(first) or not callable(second):
        raise TypeError("a paired metric must measure a statistic")
    return lambda counts: first(counts) - second(counts)


def _halves(truth: Row) -> dict[str, dict[str, float | None]]:
    """Return scores of one half of ground truth against the other, over random halves of the recordings."""
    if truth.reference.num_recordings < 2:
        return {}
    found = {
        name: metric.halves(truth) for name, metric in metrics.of_section("rows").items() if metric.halves is not None
    }
    return {name: spread(values) for name, values in found.items() if values is not None}


def _few_recordings(made: Rows) -> list[str]:
    if made.reference.num_recordings > 1:
        return []
    return [
        "all clips are of one recording, so there are no intervals, no mismatched speech and no other half; give clips "
        "of several recordings"
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
    """Return what the numbers depend on beside the motion."""
    return {
        "first_frame": SEED_FRAMES,
        "seed": seed,
        "draws": draws,
        "level": LEVEL,
        "reference_statistics": "training" if has_training else "reference",
        "beat_alignment": {
            "sigma": times.SIGMA,
            "threshold": stops.THRESHOLD,
            "silence_db": times.SILENCE_DB,
            "mismatches": summary.NUM_MISMATCHES,
        },
        "beat_align": {
            "sigma": rests.SIGMA,
            "threshold": rests.THRESHOLD,
            "order": rests.order(fps),
        },
        "pck_delta": reconstruction.DELTA,
    }
