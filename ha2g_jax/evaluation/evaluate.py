"""Score any motion against reference motion, with intervals, next to reference rows that show what a score is worth."""

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import threadpoolctl

from ha2g_jax import metrics
from ha2g_jax.data.records import WINDOW_FRAMES
from ha2g_jax.errors import UserError
from ha2g_jax.evaluation.clip_result import ClipResult
from ha2g_jax.evaluation.remarks import (
    beat_rates,
    few_recordings,
    latent_notes,
    latent_warnings,
    without_sound,
    won_metrics,
)
from ha2g_jax.evaluation.rows import Rows, make_rows
from ha2g_jax.metrics import reconstruction
from ha2g_jax.metrics.beats import rests, row_alignment, stops, times
from ha2g_jax.metrics.legacy import check_rate, legacy_notes
from ha2g_jax.metrics.metric import Score, Section, Statistic
from ha2g_jax.metrics.row import SEED_FRAMES, Row, cut_windows, row_latents
from ha2g_jax.metrics.sanity import HALF, SANITY_ROWS
from ha2g_jax.metrics.uncertainty import Estimate, Interval, bootstrap
from ha2g_jax.progress import track
from ha2g_jax.skeleton import Skeleton

if TYPE_CHECKING:  # JAX takes seconds to import, and an evaluation without latents does without
    from ha2g_jax.evaluation.features import PoseFeatures

Scores = dict[str, Score]  # name of a metric -> its score in one row

DRAWS = 1000
LEVEL = 0.95

_DIGITS = 8  # significant digits
_DIGITS_OF_ERRORS = 4  # digits after the decimal point
_Z = 1.96  # half-width of a 95 % interval, in standard errors


class Intervals:
    """Percentile intervals of statistics under resampling of recordings, with the same draws for every statistic."""

    def __init__(self, num_recordings: int, draws: int, seed: int):
        self._num_recordings, self._draws, self._seed = num_recordings, draws, seed

    def __call__(self, score: Score) -> dict[str, float | None]:
        """Return {"value", "low", "high"} of a score, None where undefined; a number has no bounds."""
        if not callable(score):
            return score_as_json(score)
        return _as_json(bootstrap(score, self._num_recordings, draws=self._draws, seed=self._seed, level=LEVEL))


# A bootstrap decomposes thousands of small matrices, for which the threads of a linear algebra library only wait for
# each other: on a busy machine this took ten times as long.
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

    The rows of `sanity.SANITY_ROWS` are always included. An interval is the 95 % percentile interval under resampling
    of the recordings; the same recordings are drawn for all rows.

    Args:
        rows: clip results of each method. A clip may have several, such as those of several seeds.
        reference: true motion, one clip result for each clip, with onsets.
        skeleton: skeleton of all motion.
        training: clips (T, bones, 3) of the training split, from which the mean pose and reference statistics (usual
            changes of angles, limits of angles) are taken; by default the reference itself.
        autoencoder: pose auto-encoder that gives the latents for FGD and diversity; None leaves these out.
        legacy: whether to add the section "legacy_v1"; beat consistency then needs the sound of the reference.
        draws: number of draws of the bootstrap; `seed` is its seed.
        notes: sentences about the motion, to add to the results.

    Returns:
        One section of results, ready for JSON: "rows": {row: {metric: {"value", "low", "high"}}}, None where undefined,
        diversity with "sd" over ten draws; "differences": {"METHOD - FIRST METHOD": the same of paired differences};
        "counts": counts of clips and rates, by row; "methods", "data", "settings", "autoencoder" (None without),
        "flags", "warnings" and "notes"; "legacy_v1" on demand.

    Raises:
        UserError: there is no method or no clip that all of them have, vectors are not of length 1, the auto-encoder
            has another skeleton or frame rate, or legacy scores are requested at a rate other than 15 frames per
            second.
    """
    if not rows or not reference:
        raise UserError("nothing to evaluate; give the motion of at least one method and of the reference")
    check_autoencoder(autoencoder, skeleton, reference[0].fps)
    if legacy:
        check_rate(reference[0].fps)
    made = make_rows(rows, reference, skeleton, training=training, autoencoder=autoencoder, seed=seed)
    intervals = Intervals(made.reference.num_recordings, draws, seed)
    found, scores = _measure_rows(made, intervals, has_legacy=legacy)
    results: dict[str, dict[str, Any]] = {name: {} for name in (*rows, *SANITY_ROWS)} | found["rows"]
    results[HALF] = _halves(made.truth)
    paired = [name for name, metric in metrics.of_section("rows").items() if metric.is_paired]
    encoded = made.truth.once(row_latents)
    section = {
        "methods": list(rows),
        "rows": results,
        "differences": differences({name: scores[name] for name in rows}, intervals, paired),
        "counts": found["counts"],
        "data": {
            "clips": len(made.ids),
            "recordings": made.reference.num_recordings,
            "seconds": round(sum(map(len, made.truth.directions)) / made.reference.fps, 2),
            "windows": None if encoded is None else len(encoded.latents),
            "skeleton": skeleton.name,
            "fps": made.reference.fps,
        },
        "settings": _settings(seed, draws, made.reference.fps, has_training=training is not None),
        "autoencoder": _describe(made.truth, autoencoder),
        "flags": [*won_metrics(results), *beat_rates(results, list(rows))],
        "warnings": [*few_recordings(made), *latent_warnings(made.truth, autoencoder)],
        "notes": [*notes, *made.notes, *without_sound(made), *latent_notes(made.truth, autoencoder)],
    }
    if legacy:
        section["legacy_v1"] = {"rows": found["legacy_v1"], "notes": legacy_notes(made.truth)}
    return section


def _measure_rows(made: Rows, intervals: Intervals, *, has_legacy: bool) -> tuple[dict[str, Any], dict[str, Scores]]:
    """Return scores with intervals by section and row, the counts by row, and the scores of "rows" themselves."""
    found: dict[str, Any] = {"rows": {}, "legacy_v1": {}, "counts": {}}
    scores = {}
    for name, row in track(made.rows.items(), "scoring", "row"):
        scores[name] = measure(row, "rows")
        found["rows"][name] = {key: intervals(score) for key, score in scores[name].items()}
        found["rows"][name] |= _draws(row, found["rows"][name])
        found["counts"][name] = {key: json_number(value) for key, value in row.once(row_alignment.clip_counts).items()}
        if has_legacy:
            found["legacy_v1"][name] = {key: intervals(score) for key, score in measure(row, "legacy_v1").items()}
        if row is not made.truth:
            row.forget()
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
            found[name] = score | {"value": json_number(values.mean()), "sd": json_number(values.std(ddof=1))}
    return found


def differences(
    scores: Mapping[str, Scores], intervals: Intervals, names: Sequence[str]
) -> dict[str, dict[str, dict[str, float | None]]]:
    """Return the paired differences of every further method minus the first one, in the metrics of some names."""
    (first, base), *others = scores.items()
    return {
        f"{name} - {first}": {
            key: intervals(_difference(own[key], base[key])) for key in names if key in own and key in base
        }
        for name, own in others
    }


def _difference(first: Any, second: Any) -> Statistic:
    return lambda counts: first(counts) - second(counts)


def _halves(truth: Row) -> dict[str, dict[str, float | None]]:
    """Return scores of one half of ground truth compared with the other, over random halves of the recordings."""
    if truth.reference.num_recordings < 2:
        return {}
    found = {
        name: metric.halves(truth) for name, metric in metrics.of_section("rows").items() if metric.halves is not None
    }
    return {name: _spread(values) for name, values in found.items() if values is not None}


def _settings(seed: int, draws: int, fps: float, *, has_training: bool) -> dict[str, Any]:
    """Return the settings that the numbers depend on, besides the motion."""
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
            "mismatches": row_alignment.NUM_MISMATCHES,
        },
        "beat_align": {
            "sigma": rests.SIGMA,
            "threshold": rests.THRESHOLD,
            "order": rests.order(fps),
        },
        "pck_delta": reconstruction.DELTA,
    }


def check_autoencoder(autoencoder: "PoseFeatures | None", skeleton: Skeleton, fps: float) -> None:
    """Raise a `UserError` if a pose auto-encoder was trained on motion of another skeleton or frame rate."""
    if autoencoder is not None and (autoencoder.skeleton.name, autoencoder.fps) != (skeleton.name, fps):
        raise UserError(
            f"the pose auto-encoder is of the skeleton {autoencoder.skeleton.name} at {autoencoder.fps:g} frames per "
            f"second, the motion of {skeleton.name} at {fps:g}; give one that was trained on such motion"
        )


def _describe(truth: Row, autoencoder: "PoseFeatures | None") -> dict[str, Any] | None:
    """Return a description of the latents for the results; None without latents."""
    found = truth.once(row_latents)
    windows = None if found is None else cut_windows(truth, found.cut)
    if autoencoder is None or windows is None:
        return None
    return {
        "id": autoencoder.id,
        "name": autoencoder.name,
        "data": autoencoder.data,
        "latent_dim": autoencoder.latent_dim,
        "fps": autoencoder.fps,
        "window": WINDOW_FRAMES,
        "reconstruction_error": json_number(autoencoder.reconstruction_error(windows)),
    }


def compare(first: Mapping[str, Any], second: Mapping[str, Any]) -> dict[str, Any]:
    """Compare two sections of results of `evaluate`.

    Returns:
        {row: {metric: {"first", "second", "difference"}}} of the rows and metrics that both have.

    Raises:
        UserError: both have an FGD, but of two auto-encoders; or they are of two skeletons or frame rates.
    """
    ids = [results["autoencoder"] and results["autoencoder"]["id"] for results in (first, second)]
    if None not in ids and ids[0] != ids[1]:
        raise UserError(
            f"one FGD is of the pose auto-encoder {ids[0][:16]}, the other of {ids[1][:16]}: distances in two latent "
            "spaces cannot be compared; evaluate both with one --autoencoder"
        )
    for key in ("skeleton", "fps"):
        if first["data"][key] != second["data"][key]:
            raise UserError(
                f"one evaluation is of {key} {first['data'][key]}, the other of {second['data'][key]}; scores of two "
                "kinds of motion cannot be compared"
            )
    return {
        row: {
            metric: _side_by_side(first["rows"][row][metric], second["rows"][row][metric])
            for metric in first["rows"][row]
            if metric in second["rows"][row]
        }
        for row in first["rows"]
        if row in second["rows"]
    }


def _side_by_side(first: dict[str, Any], second: dict[str, Any]) -> dict[str, Any]:
    before, after = first["value"], second["value"]
    difference = None if before is None or after is None else json_number(after - before)
    return {"first": first, "second": second, "difference": difference}


def _spread(values: np.ndarray) -> dict[str, float | None]:
    """Return the mean of random divisions, and the bounds of the middle 95 % of them."""
    if not len(values) or not np.isfinite(values).all():
        return _as_json(Interval(math.nan, math.nan, math.nan))
    tail = (1 - LEVEL) / 2
    low, high = np.quantile(values, [tail, 1 - tail]).tolist()
    return _as_json(Interval(float(np.mean(values)), low, high))


def _as_json(values: Any) -> dict[str, float | None]:
    """Return a NamedTuple of numbers as a dict."""
    return {name: json_number(value) for name, value in values._asdict().items()}


def json_number(value: float) -> float | None:
    """Return a number for JSON, None if it is undefined."""
    return float(f"{value:.{_DIGITS}g}") if math.isfinite(value) else None


def score_as_json(score: Score) -> dict[str, float | None]:
    """Return {"value", "low", "high"} of a score that needs no bootstrap, with "error" where it has a standard error.

    The bounds are 1.96 standard errors below and above the value; a number has none.
    """
    if not isinstance(score, Estimate):
        value = cast("float | None", score)
        return _as_json(Interval(math.nan if value is None else value, math.nan, math.nan))
    value, error = score
    bounds = (value, value - _Z * error, value + _Z * error, error)
    return {
        name: round(float(x), _DIGITS_OF_ERRORS) if math.isfinite(x) else None
        for name, x in zip(("value", "low", "high", "error"), bounds, strict=True)
    }
