"""FGD and diversity of all rows of an evaluation."""

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ha2g_jax.data.records import WINDOW_FRAMES
from ha2g_jax.errors import UserError
from ha2g_jax.metrics.frechet import SAMPLES_PER_DIMENSION, is_too_few
from ha2g_jax.skeleton import Skeleton
from ha2g_jax.study.evaluation import latent_statistics
from ha2g_jax.study.evaluation.intervals import number
from ha2g_jax.study.evaluation.latent_statistics import SourceMoments, Statistic
from ha2g_jax.study.evaluation.metrics import FGD_SEEDED, HALF, METRICS
from ha2g_jax.study.evaluation.rows import Rows

if TYPE_CHECKING:
    from ha2g_jax.study.evaluation.features import PoseFeatures

NO_AUTOENCODER = (
    "no FGD and no diversity without a pose auto-encoder; train one with "
    "`ha2g train --config experiments/configs/autoencoder.py:DATA --workdir WORKDIR` and give --autoencoder WORKDIR"
)

_BIAS = (
    "a distance of resampled sources is greater on average than that of all, so that its interval may lie above it; "
    f"a row is told from ground truth by the row {HALF}"
)


class LatentScores(NamedTuple):
    """What latents say of the rows; all empty without an auto-encoder.

    Attributes:
        statistics: {row: {metric: statistic}}.
        draws: {row: {metric: {"value", "sd"}}} of diversity over its ten draws.
        halves: {metric: (divisions,)} of ground truth's one half against the other.
        autoencoder: what the latents are of, for the results; None without.
        windows: of ground truth.
        warnings: sentences.
        notes: sentences.
    """

    statistics: dict[str, dict[str, Statistic]]
    draws: dict[str, dict[str, dict[str, float | None]]]
    halves: dict[str, np.ndarray]
    autoencoder: dict[str, str | int | float | None] | None
    windows: int | None
    warnings: list[str]
    notes: list[str]


def check_autoencoder(autoencoder: "PoseFeatures | None", skeleton: Skeleton, fps: float) -> None:
    """Refuses an auto-encoder of other motion.

    Raises:
        UserError: it is of another skeleton or frame rate.
    """
    if autoencoder is not None and (autoencoder.skeleton.name, autoencoder.fps) != (skeleton.name, fps):
        raise UserError(
            f"the pose auto-encoder is of the skeleton {autoencoder.skeleton.name} at {autoencoder.fps:g} frames per "
            f"second, the motion of {skeleton.name} at {fps:g}; give one that was trained on such motion"
        )


def score_latents(
    rows: Rows, autoencoder: "PoseFeatures | None", seed: int, advance: Callable[[], object]
) -> LatentScores:
    """Encodes the windows of all rows.

    Args:
        rows: of the evaluation.
        autoencoder: gives the latents.
        seed: of the draws of pairs and of the halves.
        advance: called after each row.
    """
    cut = latent_statistics.choose_cut([len(directions) for directions in rows.truth.directions])
    if autoencoder is None or cut is None:
        note = NO_AUTOENCODER if autoencoder is None else "no clip has 34 frames, so no FGD and no diversity"
        return LatentScores({}, {}, {}, None, None, [], [note])
    true = latent_statistics.encode(rows.truth, rows.members, cut, autoencoder)
    latents = {}
    for name, row in rows.rows.items():
        is_true = row.directions is rows.truth.directions  # of mismatched speech, the motion is true
        latents[name] = true if is_true else latent_statistics.encode(row, rows.members, cut, autoencoder)
        advance()
    true_moments = SourceMoments(true, rows.num_sources)
    statistics, draws = {}, {}
    for name, own in latents.items():
        moments = true_moments if own is true else SourceMoments(own, rows.num_sources)
        distance = latent_statistics.distance(moments, true_moments)
        first, second = latent_statistics.diversity_statistics(own, seed)
        statistics[name] = {cut.metric: distance, "diversity_l1": first, "diversity_l2": second}
        if (answers := latent_statistics.multimodality_statistic(own)) is not None:
            statistics[name]["multimodality"] = answers
        found = latent_statistics.diversity_draws(own, seed)
        draws[name] = {
            key: {"value": number(values.mean()), "sd": number(values.std(ddof=1))}
            for key, values in (("diversity_l1", found.l1), ("diversity_l2", found.l2))
        }
    encoder: dict[str, str | int | float | None] = {
        "id": autoencoder.id,
        "name": autoencoder.name,
        "data": autoencoder.data,
        "latent_dim": autoencoder.latent_dim,
        "fps": autoencoder.fps,
        "window": WINDOW_FRAMES,
        "reconstruction_error": number(
            autoencoder.reconstruction_error(latent_statistics.cut_windows(rows.truth, cut))
        ),
    }
    return LatentScores(
        statistics=statistics,
        draws=draws,
        halves={cut.metric: latent_statistics.half_distances(true, seed)},
        autoencoder=encoder,
        windows=len(true.latents),
        warnings=_warnings(cut.metric, len(true.latents), autoencoder.latent_dim),
        notes=[_BIAS, *_notes(rows, cut)],
    )


def _warnings(metric: str, count: int, latent_dim: int) -> list[str]:
    warnings = []
    if is_too_few(count, latent_dim):
        warnings.append(
            f"{count} windows for {latent_dim} latent values, less than {SAMPLES_PER_DIMENSION} times as many: the FGD "
            f"says more about their number than about the motion; compare it with the row {HALF}"
        )
    if metric == FGD_SEEDED:
        warnings.append(
            f"clips are too short to leave the seed pose out of a window, so the distance is {METRICS[metric].title}"
        )
    return warnings


def _notes(rows: Rows, cut: latent_statistics.Cut) -> list[str]:
    short = sum(not cut.starts(len(directions)) for directions in rows.truth.directions)
    return [f"{short} clips are shorter than a window and not part of FGD and diversity"] if short else []
