"""How a motion moves, whatever it says: acceleration, jerk, speeds, spread, and linear likeness to the real motion.

These are the extras that other evaluations report (GENEA, BEAT, Audio2Gestures). None is a score of its own: a value
means something beside that of the real motion. Joints are whatever is given; units are those of the positions.
"""

from collections.abc import Sequence

import numpy as np

from ha2g_jax.metrics.talk import correlation

NUM_BINS = 50
SHRINKAGE = 1e-3  # share of the identity that canonical correlation mixes into the correlations of either side

_STILL = 1e-5  # units a second below which a joint does not move: the rounding of float32 positions
_CONSTANT = 1e-6  # standard deviation below which a dimension is constant
_RANK = 1e-10  # eigenvalue of a correlation matrix below which its dimensions repeat each other


def acceleration(positions: np.ndarray, fps: float, *, first_frame: int = 4) -> float:
    """Mean over frames and joints of the length of the second difference x fps^2 (GENEA's average acceleration).

    Args:
        positions: (T, joints, 3).
        fps: frames per second.
        first_frame: frames before it were given to the model and are not scored.

    Returns:
        Units of the positions per s^2; NaN where fewer than 3 frames are scored.
    """
    return _mean_difference(positions, 2, fps, first_frame)


def jerk(positions: np.ndarray, fps: float, *, first_frame: int = 4) -> float:
    """Mean over frames and joints of the length of the third difference x fps^3 (GENEA's average jerk).

    Args:
        positions: (T, joints, 3).
        fps: frames per second.
        first_frame: frames before it were given to the model and are not scored.

    Returns:
        Units of the positions per s^3; NaN where fewer than 4 frames are scored.
    """
    return _mean_difference(positions, 3, fps, first_frame)


def l1_diversity(values: np.ndarray, *, first_frame: int = 4) -> float:
    """Spread of a sequence around its own mean, (1/T) sum_t sum_d |x_td - mean_t x_d| (Audio2Gestures, 2021).

    Args:
        values: (T, ...) positions or directions.
        first_frame: frames before it were given to the model and are not scored.

    Returns:
        Units of the values, summed over all dimensions, 0 for motion that stands still; NaN without a scored frame.
        Over clips it is averaged by `weighted_mean` with their scored frames as weights.
    """
    scored = _flat(values, first_frame)
    return float(np.mean(np.sum(np.abs(scored - scored.mean(axis=0)), axis=1))) if len(scored) else np.nan


def weighted_mean(values: np.ndarray, weights: np.ndarray) -> float:
    """Mean over clips, (n,) each, of those whose value is defined (not NaN); NaN where there is none."""
    values, weights = (np.asarray(x, np.float64) for x in (values, weights))
    is_defined = ~np.isnan(values) & (weights > 0)
    return float(np.average(values[is_defined], weights=weights[is_defined])) if is_defined.any() else np.nan


def speed_hellinger(
    clips: Sequence[np.ndarray],
    reference: Sequence[np.ndarray],
    fps: float,
    *,
    bins: int | np.ndarray = NUM_BINS,
    first_frame: int = 4,
) -> float:
    """Hellinger distance of the distributions of joint speeds, per joint and then the mean (GENEA).

    H = sqrt(1 - sum_i sqrt(p_i q_i)) in [0, 1].

    Args:
        clips, reference: of (T, joints, 3).
        fps: frames per second of both.
        bins: number of bins with edges at the quantiles of the reference, joint by joint; or upper edges in units a
            second that all joints share, such as `fixed_bins()`. Either way the last bin holds what lies beyond.
        first_frame: frames before it were given to the model and are not scored.

    Returns:
        The distance; a joint that moves nowhere is left out, so that two motions that stand still have 0. NaN where
        either side has no two scored frames.
    """
    edges = speed_edges(reference, fps, bins=bins, first_frame=first_frame) if isinstance(bins, int) else bins
    sides = []
    for side in (clips, reference):
        sides.append(np.sum([speed_counts(clip, edges, fps, first_frame=first_frame) for clip in side], axis=0))
    return histogram_distance(*sides)


def fixed_bins(width: float = 1.0, last: float = 49.0) -> np.ndarray:
    """GENEA's edges: 0 to `last` in steps of `width`, in units of the data a second; upper edges only."""
    return width * np.arange(1, round(last / width) + 1)


def speed_edges(
    reference: Sequence[np.ndarray], fps: float, *, bins: int = NUM_BINS, first_frame: int = 4
) -> np.ndarray:
    """Upper edges (joints, bins) at the quantiles 1/bins, 2/bins, ..., 1 of the reference's speeds."""
    speeds = np.concatenate([_speeds(clip, fps, first_frame) for clip in reference])
    if not len(speeds):
        return np.zeros((speeds.shape[1], bins))
    return np.quantile(speeds, np.arange(1, bins + 1) / bins, axis=0).T


def speed_counts(positions: np.ndarray, edges: np.ndarray, fps: float, *, first_frame: int = 4) -> np.ndarray:
    """Histogram of each joint's speeds in one clip; those of clips add up.

    Args:
        positions: (T, joints, 3).
        edges: (bins,) or (joints, bins) ascending upper edges, each within its bin.
        fps: frames per second.
        first_frame: frames before it were given to the model and are not scored.

    Returns:
        (joints, 1 + bins + 1) counts: of standing still, of each bin, and of what lies beyond the last.
    """
    speeds = _speeds(positions, fps, first_frame)
    num_joints, num_bins = speeds.shape[1], edges.shape[-1]
    counts = np.zeros((num_joints, num_bins + 2))
    for joint, joint_edges in enumerate(np.broadcast_to(edges, (num_joints, num_bins))):
        is_moving = speeds[:, joint] > 0
        places = np.where(is_moving, 1 + np.searchsorted(joint_edges, speeds[:, joint]), 0)
        counts[joint] = np.bincount(places, minlength=num_bins + 2)
    return counts


def histogram_distance(counts: np.ndarray, reference: np.ndarray) -> float:
    """Mean over joints of the Hellinger distance of two sums of `speed_counts`, see `speed_hellinger`."""
    # Standing still belongs to the first bin, which holds the slowest; it is counted apart only to find dead joints.
    shares = []
    for side in (counts, reference):
        if not side.sum():
            return np.nan
        binned = np.concatenate([side[:, :1] + side[:, 1:2], side[:, 2:]], axis=1)
        shares.append(binned / binned.sum(axis=1, keepdims=True))
    moves = (counts[:, 1:].sum(axis=1) > 0) | (reference[:, 1:].sum(axis=1) > 0)
    overlap = np.sum(np.sqrt(shares[0] * shares[1]), axis=1)[moves]
    return float(np.mean(np.sqrt(np.maximum(1 - overlap, 0)))) if moves.any() else 0.0


def cca(
    generated: Sequence[np.ndarray],
    real: Sequence[np.ndarray],
    sources: Sequence[str] | None = None,
    *,
    shrinkage: float = SHRINKAGE,
    seed: int = 0,
    first_frame: int = 4,
) -> float:
    """First canonical correlation of generated and real frames, on sources that it was not fitted on (GENEA).

    Args:
        generated, real: of (T, ...), clip by clip; of a pair the frames that both have are used.
        sources: source of each clip; fitted on one half of them, drawn by `seed`, and scored on the other. Without,
            fitted and scored on all frames, which is GENEA's global score and rises with the number of dimensions.
        shrinkage: share of the identity mixed into the correlations of either side; 0 is the plain analysis.
        seed: of the halves.
        first_frame: frames before it were given to the model and are not scored.

    Returns:
        Pearson correlation of the two projections in [-1, 1]; 0 where a side has nothing that varies, NaN where there
        are no frames or fewer than two sources.
    """
    pairs = canonical_pairs(generated, real, sources, shrinkage=shrinkage, seed=seed, first_frame=first_frame)
    together = np.concatenate([np.zeros((0, 2)), *pairs])
    if len(together) < 2:
        return np.nan
    value = correlation(together)
    return value if np.isfinite(value) else 0.0


def canonical_pairs(
    generated: Sequence[np.ndarray],
    real: Sequence[np.ndarray],
    sources: Sequence[str] | None = None,
    *,
    shrinkage: float = SHRINKAGE,
    seed: int = 0,
    first_frame: int = 4,
) -> list[np.ndarray]:
    """Projections (frames, 2) of the generated and the real frames of each clip that `cca` scores.

    The arguments are those of `cca`. From resampled clips follows an interval without another fit.
    """
    sides = [[_flat(clip, first_frame) for clip in side] for side in (generated, real)]
    lengths = [min(len(x), len(y)) for x, y in zip(*sides, strict=True)]
    xs, ys = ([clip[:length] for clip, length in zip(side, lengths, strict=True)] for side in sides)
    fitted = scored = range(len(xs))
    if sources is not None:
        names = np.random.default_rng(seed).permutation(np.unique(sources))
        is_first = np.isin(sources, names[: len(names) // 2])
        fitted, scored = np.flatnonzero(is_first), np.flatnonzero(~is_first)
    if not sum(lengths[clip] for clip in fitted):
        return []
    x, y = (np.concatenate([side[clip] for clip in fitted]) for side in (xs, ys))
    first, second = _canonical_weights(x, y, shrinkage)
    return [np.stack([xs[clip] @ first, ys[clip] @ second], axis=1) for clip in scored]


def _canonical_weights(x: np.ndarray, y: np.ndarray, shrinkage: float) -> tuple[np.ndarray, np.ndarray]:
    """The two directions whose projections of (n, d) and (n, e) correlate most; 0 on constant dimensions."""
    white, weights = [], []
    for side in (x, y):
        spread = side.std(axis=0)
        scale = np.where(spread > _CONSTANT, 1 / np.maximum(spread, _CONSTANT), 0)
        values = (side - side.mean(axis=0)) * scale
        correlations = (1 - shrinkage) * values.T @ values / len(values) + shrinkage * np.diag(scale > 0)
        variances, axes = np.linalg.eigh(correlations)
        root = (axes * np.where(variances > _RANK, 1 / np.sqrt(np.maximum(variances, _RANK)), 0)) @ axes.T
        white.append(values @ root)
        weights.append(scale[:, None] * root)
    left, _, right = np.linalg.svd(white[0].T @ white[1] / len(x), full_matrices=False)
    return weights[0] @ left[:, 0], weights[1] @ right[0]


def _flat(values: np.ndarray, first_frame: int) -> np.ndarray:
    """Scored frames as rows (frames, dimensions) in float64."""
    scored = np.asarray(values, np.float64)[first_frame:]
    return scored.reshape(len(scored), int(np.prod(scored.shape[1:])))


def _mean_difference(positions: np.ndarray, order: int, fps: float, first_frame: int) -> float:
    scored = np.asarray(positions, np.float64)[first_frame:]
    if len(scored) <= order:
        return np.nan
    return float(np.mean(np.linalg.norm(np.diff(scored, n=order, axis=0), axis=-1)) * fps**order)


def _speeds(positions: np.ndarray, fps: float, first_frame: int) -> np.ndarray:
    """Speeds (frames - 1, joints) of the scored frames; 0 below the rounding of positions."""
    scored = np.asarray(positions, np.float64)[first_frame:]
    speeds = np.linalg.norm(np.diff(scored, axis=0), axis=-1) * fps
    return np.where(speeds < _STILL, 0, speeds)
