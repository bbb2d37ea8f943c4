"""The scores that the field's public code computes, by its rules and with their faults: to be put beside old tables.

legacy_v1: windows of 34 frames, seed pose included, from the first frame of each clip on and without overlap; the last
partial batch is dropped; FGD, Diversity and both variants of beat consistency as in `metrics.frechet`,
`metrics.diversity` and `metrics.legacy_beats`. Vectors are of unit length here, which a network's own output is not.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from ha2g_jax.data.records import WINDOW_FRAMES
from ha2g_jax.features.audio import window_samples
from ha2g_jax.metrics import beats, diversity, frechet, legacy_beats, sanity
from ha2g_jax.skeleton import Skeleton
from ha2g_jax.study.evaluation.intervals import number
from ha2g_jax.study.evaluation.latent_statistics import Cut, cut_windows
from ha2g_jax.study.evaluation.metrics import MISMATCHED
from ha2g_jax.study.evaluation.rows import Row, Rows

_WINDOW_SAMPLES = window_samples(WINDOW_FRAMES, 15)

BATCH = 32  # windows of a batch, as in the release's evaluation alone

_CUT = Cut("", 0)


def legacy_scores(
    rows: Rows,
    skeleton: Skeleton,
    features: Callable[[np.ndarray], np.ndarray] | None,
    *,
    batch_size: int = BATCH,
    seed: int = 0,
) -> dict[str, Any]:
    """The section "legacy_v1" of the results: "rows" as those of `evaluation.evaluate`, without intervals, and "notes".

    Args:
        rows: of the evaluation.
        skeleton: whose constants beat consistency takes.
        features: of the auto-encoder, (n, 34, bones, 3) -> (n, d); FGD and Diversity are left out without.
        batch_size: of the loader that is imitated.
        seed: of the permutation of batches.
    """
    notes = [f"batches of {batch_size} windows, seed pose included; no intervals, no direction is better"]
    onsets = _window_onsets(rows)
    if onsets is None:
        notes.append("no sound, so no beat consistency")
    elif silent := sum(not len(times) for times in onsets.values()):
        notes.append(f"{silent} of {len(onsets)} windows have no onset, where the rule divides by 0, and are left out")
    true_windows = _windows(rows.truth)
    true = None if features is None or true_windows is None else features(true_windows)
    scores = {}
    for name, row in rows.rows.items():
        windows = _windows(row)
        found: dict[str, float] = {}
        if onsets is not None and windows is not None:
            found |= _beat_consistency(name, row, rows, windows, onsets, skeleton, seed)
        if features is not None and true is not None and windows is not None:
            found |= _latent_scores(features(windows), true, batch_size, seed)
        scores[name] = {key: {"value": number(value), "low": None, "high": None} for key, value in found.items()}
    if true is not None and len(true) < batch_size:
        notes.append(f"{len(true)} windows make no batch of {batch_size}, so no FGD and no Diversity")
    return {"rows": scores, "notes": notes}


def _windows(row: Row) -> np.ndarray | None:
    """Windows of a row, None where no clip is as long as one."""
    has_any = any(_CUT.starts(len(directions)) for directions in row.directions)
    return cut_windows(row, _CUT) if has_any else None


def _latent_scores(own: np.ndarray, true: np.ndarray, batch_size: int, seed: int) -> dict[str, float]:
    whole, whole_true = (len(latents) // batch_size * batch_size for latents in (own, true))
    if not whole or not whole_true:
        return {}
    found = {
        "legacy_fgd": frechet.legacy_distance(own[:whole], true[:whole_true]),
        "legacy_diversity": diversity.legacy_diversity(own, batch_size, seed),
    }
    if len(own) == len(true):
        found["legacy_feature_distance"] = frechet.legacy_feature_distance(own[:whole], true[:whole])
    return found


def _window_onsets(rows: Rows) -> dict[tuple[int, int], np.ndarray] | None:
    """Onsets of each window's own samples, heard alone, by clip and first frame; None where no clip has sound."""
    onsets = {}
    for clip, (directions, audio) in enumerate(zip(rows.truth.directions, rows.audio, strict=True)):
        for start in _CUT.starts(len(directions)):
            if audio is not None:
                first = round(start * _WINDOW_SAMPLES / WINDOW_FRAMES)
                sound = audio[first : first + _WINDOW_SAMPLES]
                onsets[clip, start] = beats.onsets(np.pad(sound, (0, _WINDOW_SAMPLES - len(sound))))
    return onsets or None


def _beat_consistency(
    name: str,
    row: Row,
    rows: Rows,
    windows: np.ndarray,
    onsets: dict[tuple[int, int], np.ndarray],
    skeleton: Skeleton,
    seed: int,
) -> dict[str, float]:
    """Both variants; windows without an onset, where the rule divides by zero, are left out."""
    places = [
        (int(number), start)
        for number, directions in zip(row.numbers, row.directions, strict=True)
        for start in _CUT.starts(len(directions))
    ]
    heard = [onsets.get(place, np.zeros(0)) for place in places]
    if name == MISMATCHED:
        sources = [str(rows.sources[number]) for number, _ in places]
        if len(set(sources)) < 2:
            return {}
        heard = [heard[other] for other in sanity.derangement(sources, np.random.default_rng(seed))]
    kept = [index for index, times in enumerate(heard) if len(times)]
    if not kept:
        return {}
    return {
        f"legacy_bc_{variant}": legacy_beats.legacy_bc(
            skeleton, windows[kept], [heard[index] for index in kept], variant=variant
        )
        for variant in legacy_beats.VARIANTS
    }
