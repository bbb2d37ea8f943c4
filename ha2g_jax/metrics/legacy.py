"""FGD, Diversity, beat consistency and errors by the rules of the public release, for comparison with old tables only.

The rules are kept with their faults. The metrics of legacy_v1 use windows of 34 frames, including the seed pose, from
the first frame of each clip on and without overlap; the last partial batch of 32 is dropped. Vectors have unit length
here, unlike the output of a network.
"""

import logging
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from ha2g_jax.errors import UserError
from ha2g_jax.features.audio import window_samples
from ha2g_jax.metrics import sanity
from ha2g_jax.metrics.beats.stops import angle_change_rates, low_samples
from ha2g_jax.metrics.beats.times import detect_onsets, kernel, nearest
from ha2g_jax.metrics.metric import LEGACY, Direction, Metric
from ha2g_jax.metrics.row import Cut, Reference, Row, cut_windows, places
from ha2g_jax.skeleton import Skeleton, load_skeleton

LEGACY_BATCHES = 500
LEGACY_FAILURE = 1e10

_logger = logging.getLogger(__name__)

NUM_FRAMES = 34
FPS = 15
SIGMA = 0.1  # seconds
THRESHOLD = 0.03

BATCH = 32  # windows of a batch, as in the evaluation of the release

_CUT = Cut("legacy", 0, NUM_FRAMES)
_WINDOW_SAMPLES = window_samples(NUM_FRAMES, FPS)


def check_rate(fps: float) -> None:
    """Raise a `UserError` if motion has another frame rate than that of the release."""
    if fps != FPS:
        raise UserError(f"the legacy scores are those of {FPS} frames per second, not of {fps:g}; leave them out")


class LegacyErrors(NamedTuple):
    """The two errors of the public release, in metres, and in metres per frame^2."""

    joint_mae: float
    acceleration: float


def legacy_distance(generated: np.ndarray, real: np.ndarray) -> float:
    """Compute the FGD of latents (n, d) and (m, d), read in float32, by the rules of the release.

    Means are computed in float32, covariances (n - 1) in float64, and the general square root of S1 S2 by a Schur
    decomposition. If the root is not finite, 1e-6 is added to both diagonals and the root is taken again. The real part
    of a complex root is used unless its diagonal has an imaginary part above 1e-3. If this fails too, the score is
    1e10.
    """
    generated, real = np.asarray(generated, np.float32), np.asarray(real, np.float32)
    if min(len(generated), len(real)) < 2 or not (np.isfinite(generated).all() and np.isfinite(real).all()):
        return LEGACY_FAILURE
    step = generated.mean(axis=0) - real.mean(axis=0)
    covariances = [np.atleast_2d(np.cov(rows, rowvar=False)) for rows in (generated, real)]
    root = _schur_root(covariances[0] @ covariances[1])
    if not np.isfinite(root).all():
        _logger.warning("legacy FGD: the product of covariances has no square root; 1e-6 added to their diagonals")
        offset = 1e-6 * np.eye(len(root))
        root = _schur_root((covariances[0] + offset) @ (covariances[1] + offset))
    diagonal = np.diagonal(root)
    if not np.isfinite(root).all() or np.max(np.abs(np.imag(diagonal))) > 1e-3:
        return LEGACY_FAILURE
    traces = np.trace(covariances[0]) + np.trace(covariances[1]) - 2 * np.sum(np.real(diagonal))
    return float(step.dot(step) + traces)


def legacy_feature_distance(generated: np.ndarray, real: np.ndarray) -> float:
    """Compute "feat_D" of the release: the mean L1 distance between the generated and the real latent of a sample."""
    return float(np.abs(np.asarray(generated, np.float64) - np.asarray(real, np.float64)).sum(axis=1).mean())


def legacy_diversity(latents: np.ndarray, batch_size: int, seed: int) -> float:
    """Compute the diversity by the rules of the release, which pair whole batches.

    The first 500 batches of the latents (n, d), in the order of the loader, are paired row by row with the first 500 of
    a random permutation of all batches. The value, the mean L1 distance over the rows, depends on the batch size, and a
    batch may be paired with itself. The last, partial batch is dropped; NaN without a whole one.
    """
    num_batches = len(latents) // batch_size
    if not num_batches:
        return np.nan
    batches = np.asarray(latents, np.float64)[: num_batches * batch_size].reshape(num_batches, batch_size, -1)
    others = batches[np.random.default_rng(seed).permutation(num_batches)]
    difference = batches[:LEGACY_BATCHES] - others[:LEGACY_BATCHES]
    return float(np.abs(difference).sum(axis=-1).mean())


def legacy_errors(generated: np.ndarray, real: np.ndarray) -> LegacyErrors:
    """Compute the errors of reconstruction by the rules of the release, means over everything.

    Bones keep the length of their vectors, and they are always those of TED-Gesture (the first 9 of any skeleton). The
    joint error is over frames from the 5th on, the acceleration error over all.

    Args:
        generated, real: (n, T, bones, 3) vectors with the mean added, not normalised; bones >= 9, T >= 5.
    """
    skeleton = load_skeleton("ted_gesture")
    lengthened = (skeleton.paths * skeleton.lengths).astype(np.float64)
    first, second = (
        lengthened @ np.asarray(vectors, np.float64)[..., : skeleton.num_bones, :] for vectors in (generated, real)
    )
    difference = second - first
    return LegacyErrors(
        float(np.mean(np.abs(difference[:, 4:]))), float(np.mean(np.abs(np.diff(difference, n=2, axis=1))))
    )


@np.errstate(over="ignore", invalid="ignore")  # a root that is not finite has its rule in the caller
def _schur_root(matrix: np.ndarray) -> np.ndarray:
    """Return the general square root of a matrix, NaN where there is none (Björck and Hammarling 1983).

    It is implemented here because the result of scipy's `sqrtm` for singular matrices, and with it the legacy value,
    depends on its version: for the root of 0, 1.17 returns 0 and 1.18 infinities.
    """
    from scipy import linalg

    triangle, vectors = linalg.schur(matrix)[:2]
    if np.any(np.tril(triangle, -1)) or np.any(np.diagonal(triangle) < 0):
        triangle, vectors = linalg.rsf2csf(triangle, vectors)
    root = np.diag(np.sqrt(np.diagonal(triangle)))
    rounding = len(root) * np.finfo(np.float64).eps * np.abs(triangle).max()
    for column in range(1, len(root)):
        for row in range(column - 1, -1, -1):
            rest = triangle[row, column] - root[row, row + 1 : column] @ root[row + 1 : column, column]
            scale = root[row, row] + root[column, column]
            if scale == 0 and abs(rest) > rounding:
                return np.full_like(root, np.nan)
            root[row, column] = rest / scale if scale else 0
    return vectors @ root @ vectors.conj().T


def legacy_bc(
    skeleton: Skeleton,
    directions: np.ndarray,
    onsets: Sequence[np.ndarray],
    *,
    variant: str = "paper",
    threshold: float = THRESHOLD,
) -> float:
    """Compute the mean over the onsets of all clips with motion beats of exp(-d^2 / (2 0.1^2)), d to the nearest beat.

    It is only a recall of the onsets, leaves motionless clips out, and scores white jitter highest. A motion beat is at
    the time t / 15 of a frame t whose rate is below both neighbours, and below one of them by the threshold. "paper"
    uses the angles of mean-subtracted vectors, as the published numbers do, "fixed" those of the poses; the mean
    absolute angle changes are those of the poses in both. Angles of rigid parts are left out, because the rule divides
    by their change, which is rounding error, and so are clips without an onset, because it divides by their number.

    Args:
        skeleton: skeleton with mean directions, angle pairs and mean absolute angle changes.
        directions: (n, 34, bones, 3) restored direction vectors, mean included; the seed poses are scored too. To
            compare with published numbers, give the output of a network as it is, not scaled to unit length.
        onsets: (k,) onsets of each window in seconds, by librosa's detector with all defaults on 36267 samples.
        variant: "paper" or "fixed".
        threshold: least rise of the rate to the next frame, on either side.

    Returns:
        The score; NaN where no clip has a motion beat and an onset.
    """
    mean = skeleton.mean_directions if variant == "paper" else np.zeros_like(skeleton.mean_directions)
    rates = angle_change_rates(skeleton, directions - mean)
    total, count = 0.0, 0
    for rate, sounds in zip(rates, onsets, strict=True):
        beats = (1 + low_samples(rate, threshold)) / FPS
        if len(beats) and len(sounds):
            total += float(kernel(nearest(np.sort(sounds), beats), SIGMA).sum())
            count += len(sounds)
    return total / count if count else float("nan")


def window_onsets(reference: Reference) -> dict[tuple[int, int], np.ndarray] | None:
    """Return the onsets of each window, found in its samples alone, by clip and first frame; None without sound."""
    onsets = {}
    for clip, (directions, audio) in enumerate(zip(reference.directions, reference.audio, strict=True)):
        for start in _CUT.starts(len(directions)):
            if audio is not None:
                first = round(start * _WINDOW_SAMPLES / _CUT.window)
                sound = audio[first : first + _WINDOW_SAMPLES]
                onsets[clip, start] = detect_onsets(np.pad(sound, (0, _WINDOW_SAMPLES - len(sound))))
    return onsets or None


def _windows(row: Row) -> np.ndarray | None:
    return cut_windows(row, _CUT)


def _latents(row: Row) -> np.ndarray | None:
    windows = row.once(_windows)
    return None if row.reference.encode is None or windows is None else row.reference.encode(windows)


def _whole(latents: np.ndarray) -> np.ndarray:
    return latents[: len(latents) // BATCH * BATCH]


def _latent_score(
    function: Callable[[np.ndarray, np.ndarray, int], float | None],
) -> Callable[[Row], float | None]:
    """Return a measure: a function of the latents of a row, of those of ground truth, and of the seed."""

    def measure(row: Row) -> float | None:
        own, true = row.once(_latents), row.reference.truth.once(_latents)
        if own is None or true is None or min(len(own), len(true)) < BATCH:
            return None
        return function(own, true, row.reference.seed)

    return measure


def _feature_distance(own: np.ndarray, true: np.ndarray, seed: int) -> float | None:
    return legacy_feature_distance(_whole(own), _whole(true)) if len(own) == len(true) else None


def _beat_consistency(variant: str) -> Callable[[Row], float | None]:
    def measure(row: Row) -> float | None:
        reference, windows = row.reference, row.once(_windows)
        onsets = reference.once(window_onsets)
        if onsets is None or windows is None:
            return None
        found = places(row, _CUT)
        sounds = [onsets.get(place, np.zeros(0)) for place in found]
        if not row.has_counterpart:  # the speech is mismatched
            names = [str(reference.recordings[number]) for number, _ in found]
            if len(set(names)) < 2:
                return None
            sounds = [sounds[other] for other in sanity.derangement(names, np.random.default_rng(reference.seed))]
        return legacy_bc(reference.skeleton, windows, sounds, variant=variant)

    return measure


def _errors(row: Row) -> LegacyErrors | None:
    own = row.once(_windows)
    if own is None or not row.has_counterpart:
        return None
    reference = row.reference
    true = [reference.directions[clip][start : start + _CUT.window] for clip, start in places(row, _CUT)]
    return legacy_errors(own, np.stack(true))


def _error(name: str) -> Callable[[Row], float | None]:
    def measure(row: Row) -> float | None:
        errors = row.once(_errors)
        return None if errors is None else getattr(errors, name)

    return measure


def _metric(name: str, title: str, direction: Direction, digits: int, measure: Callable, unit: str = "") -> Metric:
    return Metric(f"legacy_{name}", title, unit, direction, LEGACY, digits, measure, "legacy_v1")


_fgd = _latent_score(lambda own, true, seed: legacy_distance(_whole(own), _whole(true)))
_diversity = _latent_score(lambda own, true, seed: legacy_diversity(own, BATCH, seed))

LEGACY_METRICS = (
    _metric("fgd", "FGD", "lower", 3, _fgd),
    _metric("feature_distance", "feature L1", "lower", 3, _latent_score(_feature_distance)),
    _metric("bc_paper", "BC paper", "higher", 3, _beat_consistency("paper")),
    _metric("bc_fixed", "BC fixed", "higher", 3, _beat_consistency("fixed")),
    _metric("diversity", "Diversity", "higher", 2, _diversity),
    _metric("joint_mae", "joint MAE", "lower", 4, _error("joint_mae"), "m"),
    _metric("acceleration", "acc. error", "lower", 4, _error("acceleration"), "m/frame²"),
)


def legacy_notes(truth: Row) -> list[str]:
    """Return notes on what the legacy scores of a table leave out, from its row of ground truth."""
    notes = [f"batches of {BATCH} windows, seed pose included; no intervals, no direction is better"]
    onsets, windows = truth.reference.once(window_onsets), truth.once(_windows)
    if onsets is None:
        notes.append("no sound, so no beat consistency")
    elif silent := sum(not len(times) for times in onsets.values()):
        notes.append(f"{silent} of {len(onsets)} windows have no onset, where the rule divides by 0, and are left out")
    if truth.reference.encode is not None and windows is not None and len(windows) < BATCH:
        notes.append(f"{len(windows)} windows make no batch of {BATCH}, so no FGD and no Diversity")
    return notes
