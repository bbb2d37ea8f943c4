"""The registered metrics by the rules of the public release, for comparison with old tables only.

legacy_v1: windows of 34 frames, seed pose included, from the first frame of each clip on and without overlap; the last
partial batch of 32 is dropped. Vectors are of unit length here, which the output of a network is not.
"""

from collections.abc import Callable

import numpy as np

from ha2g_jax.features.audio import window_samples
from ha2g_jax.metrics import beats, sanity
from ha2g_jax.metrics.latents import Cut, cut_windows, places
from ha2g_jax.metrics.legacy import (
    LegacyErrors,
    legacy_distance,
    legacy_diversity,
    legacy_errors,
    legacy_feature_distance,
)
from ha2g_jax.metrics.metric import LEGACY, Metric
from ha2g_jax.metrics.row import Reference, Row

BATCH = 32  # windows of a batch, as in the evaluation of the release

_CUT = Cut("legacy", 0, 34)
_WINDOW_SAMPLES = window_samples(34, 15)


def window_onsets(reference: Reference) -> dict[tuple[int, int], np.ndarray] | None:
    """Return the onsets of the samples of each window alone, by clip and first frame; None where no clip has sound."""
    onsets = {}
    for clip, (directions, audio) in enumerate(zip(reference.directions, reference.audio, strict=True)):
        for start in _CUT.starts(len(directions)):
            if audio is not None:
                first = round(start * _WINDOW_SAMPLES / _CUT.window)
                sound = audio[first : first + _WINDOW_SAMPLES]
                onsets[clip, start] = beats.detect_onsets(np.pad(sound, (0, _WINDOW_SAMPLES - len(sound))))
    return onsets or None


def _windows(row: Row) -> np.ndarray | None:
    return cut_windows(row, _CUT)


def _latents(row: Row) -> np.ndarray | None:
    """Return the latents of whole and partial batches; None without an auto-encoder or a window."""
    windows = row.once(_windows)
    return None if row.reference.encode is None or windows is None else row.reference.encode(windows)


def _whole(latents: np.ndarray) -> np.ndarray:
    """Return the latents of whole batches."""
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
    """Return a measure; windows without an onset, where the rule divides by zero, are left out."""

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
        kept = [index for index, times in enumerate(sounds) if len(times)]
        if not kept:
            return None
        return beats.legacy_bc(reference.skeleton, windows[kept], [sounds[index] for index in kept], variant=variant)

    return measure


def _errors(row: Row) -> LegacyErrors | None:
    own = row.once(_windows)
    if own is None or not row.has_counterpart:
        return None
    reference = row.reference
    true = [reference.directions[clip][start : start + _CUT.window] for clip, start in places(row, _CUT)]
    return legacy_errors(own, np.stack(true))


def _error(name: str) -> Callable[[Row], float | None]:
    """Return a measure: one of the errors of reconstruction."""

    def measure(row: Row) -> float | None:
        errors = row.once(_errors)
        return None if errors is None else getattr(errors, name)

    return measure


LEGACY_METRICS = (
    Metric(
        "legacy_fgd",
        "FGD",
        "",
        "lower",
        LEGACY,
        3,
        _latent_score(lambda own, true, seed: legacy_distance(_whole(own), _whole(true))),
        "legacy_v1",
    ),
    Metric(
        "legacy_feature_distance", "feature L1", "", "lower", LEGACY, 3, _latent_score(_feature_distance), "legacy_v1"
    ),
    Metric("legacy_bc_paper", "BC paper", "", "higher", LEGACY, 3, _beat_consistency("paper"), "legacy_v1"),
    Metric("legacy_bc_fixed", "BC fixed", "", "higher", LEGACY, 3, _beat_consistency("fixed"), "legacy_v1"),
    Metric(
        "legacy_diversity",
        "Diversity",
        "",
        "higher",
        LEGACY,
        2,
        _latent_score(lambda own, true, seed: legacy_diversity(own, BATCH, seed)),
        "legacy_v1",
    ),
    Metric("legacy_joint_mae", "joint MAE", "m", "lower", LEGACY, 4, _error("joint_mae"), "legacy_v1"),
    Metric("legacy_acceleration", "acc. error", "m/frame²", "lower", LEGACY, 4, _error("acceleration"), "legacy_v1"),
)


def legacy_notes(truth: Row) -> list[str]:
    """Return sentences on what the legacy scores leave out.

    Args:
        truth: row of ground truth.
    """
    notes = [f"batches of {BATCH} windows, seed pose included; no intervals, no direction is better"]
    onsets, windows = truth.reference.once(window_onsets), truth.once(_windows)
    if onsets is None:
        notes.append("no sound, so no beat consistency")
    elif silent := sum(not len(times) for times in onsets.values()):
        notes.append(f"{silent} of {len(onsets)} windows have no onset, where the rule divides by 0, and are left out")
    if truth.reference.encode is not None and windows is not None and len(windows) < BATCH:
        notes.append(f"{len(windows)} windows make no batch of {BATCH}, so no FGD and no Diversity")
    return notes
