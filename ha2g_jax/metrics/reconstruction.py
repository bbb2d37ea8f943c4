"""Reconstruction errors, and the canonical correlation with the real motion, which a good gesture need not resemble."""

from collections.abc import Callable, Sequence

import numpy as np

from ha2g_jax.metrics.metric import RECONSTRUCTION, Metric, Statistic
from ha2g_jax.metrics.row import SEED_FRAMES, Row, mean_over_clips

DELTA = 0.1  # metres; a joint with a smaller error counts as correct

SHRINKAGE = 1e-3  # weight of the identity that is mixed into the correlations of either side

_CONSTANT = 1e-6  # standard deviation below which a dimension is constant
_RANK = 1e-10  # eigenvalue of a correlation matrix below which dimensions repeat each other


def joint_mae(generated: np.ndarray, real: np.ndarray) -> float:
    """Compute the mean of |p_hat - p| over (T, joints, 3), the root among the joints; NaN without a frame.

    Raises:
        ValueError: the two have different shapes.
    """
    return _mean_absolute(_difference(generated, real))


def acceleration_error(generated: np.ndarray, real: np.ndarray, fps: float) -> float:
    """Compute the mean of |difference of the second differences of positions| x fps^2, see `joint_mae`."""
    difference = _difference(generated, real)
    return np.nan if len(difference) < 3 else _mean_absolute(np.diff(difference, n=2, axis=0) * fps**2)


def pck(generated: np.ndarray, real: np.ndarray, *, delta: float = DELTA) -> float:
    """Compute PCK, the fraction of joints in all frames whose L1 error is below `delta`, see `joint_mae`.

    `delta` is in units of the positions.
    Without semantic weights of the frames it equals the semantic-relevant gesture recall of BEAT (Liu et al., 2022).
    """
    errors = np.abs(_difference(generated, real)).sum(axis=-1)
    return float(np.mean(np.where(np.isnan(errors), np.nan, errors < delta))) if errors.size else np.nan


def _difference(generated: np.ndarray, real: np.ndarray) -> np.ndarray:
    generated, real = np.asarray(generated, np.float64), np.asarray(real, np.float64)
    if generated.shape != real.shape:
        raise ValueError(f"positions of the shapes {generated.shape}, {real.shape}; expected the same (T, joints, 3)")
    return generated - real


def _mean_absolute(values: np.ndarray) -> float:
    return float(np.mean(np.abs(values))) if values.size else np.nan


def _to_counterpart(function: Callable[..., float]) -> Callable[[Row], Statistic | None]:
    """Return a measure: the mean over clips, weighted by scored frames, of a function of positions and true ones."""

    def measure(row: Row) -> Statistic | None:
        if not row.has_counterpart:
            return None
        values = [
            function(own[SEED_FRAMES:], true[SEED_FRAMES:], row.reference.fps)
            for own, true in zip(row.positions, row.true_positions, strict=True)
        ]
        return mean_over_clips(row, values, row.num_scored)

    return measure


JOINT_MAE = Metric(
    "joint_mae",
    "joint MAE",
    "m",
    "lower",
    RECONSTRUCTION,
    4,
    _to_counterpart(lambda own, true, fps: joint_mae(own, true)),
    is_paired=True,
)
ACCELERATION_ERROR = Metric(
    "acceleration_error", "acc. error", "m/s²", "lower", RECONSTRUCTION, 2, _to_counterpart(acceleration_error)
)
PCK = Metric(
    "pck",
    "PCK",
    "",
    "higher",
    RECONSTRUCTION,
    3,
    _to_counterpart(lambda own, true, fps: pck(own, true)),
    is_paired=True,
)


def correlation(pairs: np.ndarray) -> float:
    """Return the Pearson correlation of the two columns of (n, 2); NaN where a column is constant."""
    centred = pairs - np.mean(pairs, axis=0, keepdims=True)
    x, y = centred[:, 0], centred[:, 1]
    scale = np.sqrt(np.sum(x * x) * np.sum(y * y))
    return float(np.sum(x * y) / scale) if scale > 1e-9 else float("nan")


def canonical_pairs(
    generated: Sequence[np.ndarray],
    real: Sequence[np.ndarray],
    recordings: Sequence[str] | np.ndarray | None = None,
    *,
    shrinkage: float = SHRINKAGE,
    seed: int = 0,
) -> dict[int, np.ndarray]:
    """Project generated and real frames on the directions of their first canonical correlation (GENEA).

    Args:
        generated, real: (T, ...) frames of each clip; of a pair, the frames that both have are used.
        recordings: recording of each clip; the directions are fitted on one half of the recordings, drawn with `seed`,
            and the other half is projected. If None, all frames are fitted and projected, which is the global score of
            GENEA and rises with the number of dimensions.
        shrinkage: weight of the identity mixed into the correlations of either side; 0 for the plain analysis.

    Returns:
        {index of a projected clip: (frames, 2) projections}; empty where there is nothing to fit. The correlation of
        the two columns is the score.
    """
    sides = [[_flat(clip) for clip in side] for side in (generated, real)]
    lengths = [min(len(x), len(y)) for x, y in zip(*sides, strict=True)]
    xs, ys = ([clip[:length] for clip, length in zip(side, lengths, strict=True)] for side in sides)
    fitted = projected = range(len(xs))
    if recordings is not None:
        names = np.random.default_rng(seed).permutation(np.unique(recordings))
        is_first = np.isin(recordings, names[: len(names) // 2])
        fitted, projected = np.flatnonzero(is_first).tolist(), np.flatnonzero(~is_first).tolist()
    if not sum(lengths[clip] for clip in fitted):
        return {}
    x, y = (np.concatenate([side[clip] for clip in fitted]) for side in (xs, ys))
    first, second = _canonical_weights(x, y, shrinkage)
    return {clip: np.stack([xs[clip] @ first, ys[clip] @ second], axis=1) for clip in projected}


def _canonical_weights(x: np.ndarray, y: np.ndarray, shrinkage: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the two directions whose projections of (n, d) and (n, e) correlate most; 0 on constant dimensions."""
    scaled, roots, scales = [], [], []
    for side in (x, y):
        spread = side.std(axis=0)
        scale = np.where(spread > _CONSTANT, 1 / np.maximum(spread, _CONSTANT), 0)
        values = (side - side.mean(axis=0)) * scale
        correlations = (1 - shrinkage) * values.T @ values / len(values) + shrinkage * np.diag(scale > 0)
        variances, axes = np.linalg.eigh(correlations)
        roots.append((axes * np.where(variances > _RANK, 1 / np.sqrt(np.maximum(variances, _RANK)), 0)) @ axes.T)
        scaled.append(values)
        scales.append(scale)
    cross = roots[0].T @ (scaled[0].T @ scaled[1] / len(x)) @ roots[1]
    left, _, right = np.linalg.svd(cross, full_matrices=False)
    return scales[0] * (roots[0] @ left[:, 0]), scales[1] * (roots[1] @ right[0])


def _flat(values: np.ndarray) -> np.ndarray:
    return np.asarray(values, np.float64).reshape(len(values), int(np.prod(values.shape[1:])))


def _correlation_with_truth(row: Row) -> Statistic | None:
    """Return the correlation for any draw of recordings; None without a counterpart or a second recording."""
    reference = row.reference
    if not row.has_counterpart or reference.num_recordings < 2:
        return None
    names = reference.recordings[row.numbers]
    found, true = ([clip[SEED_FRAMES:] for clip in side] for side in (row.positions, row.true_positions))
    pairs = canonical_pairs(found, true, names, seed=reference.seed)
    together = np.concatenate([np.zeros((0, 2)), *pairs.values()])
    if len(together) < 2:
        return None
    sums, centre = np.zeros((reference.num_recordings, 6)), together.mean(axis=0)
    for clip, projections in pairs.items():
        x, y = (projections - centre).T
        sums[row.members[clip]] += len(x), x.sum(), y.sum(), x @ x, y @ y, x @ y
    return lambda counts: correlation_of_sums(counts @ sums)


def correlation_of_sums(sums: np.ndarray) -> float:
    """Return the Pearson correlation from count, sums, and sums of squares and products; 0 if a side is constant."""
    count, x, y, xx, yy, xy = sums
    if count < 2:
        return np.nan
    scale = np.sqrt(max(xx - x * x / count, 0) * max(yy - y * y / count, 0))
    return float((xy - x * y / count) / scale) if scale > 1e-9 else 0.0


CCA = Metric("cca", "CCA", "", "higher", RECONSTRUCTION, 3, _correlation_with_truth, is_paired=True)
