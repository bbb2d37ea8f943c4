"""Beat consistency, corrected: do the stops of a motion meet the onsets of the voice, more than by chance?

The paper (HA2G, section 4.3 and supplement E) asks only whether each onset has a motion beat near it, so that dense
random beats score best and a motionless clip can be passed over. Here both directions count (recall R of the onsets,
precision Q of the motion beats, F = 2 R Q / (R + Q)), a motionless clip scores 0, and the number to report is the gain
of F over that with mismatched speech. Closer to the real motion's values is better, not higher.

The way: `angle_change_rates` of the motions, `audio_onsets` of the sounds, `make_clips` of both, `align` and
`mismatched`, `summary`. Per-clip values are kept for intervals, by resampling of recordings.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ha2g_jax.metrics.angle_change import angle_change_rate, angle_change_rates, mean_angle_change
from ha2g_jax.metrics.beats import SIGMA
from ha2g_jax.metrics.clip_alignment import Alignment, align, harmonic_mean
from ha2g_jax.metrics.clip_beats import (
    FIRST_FRAME,
    SILENCE_DB,
    THRESHOLD,
    Clip,
    audio_onsets,
    make_clips,
    motion_beats,
)
from ha2g_jax.metrics.mismatched_speech import mismatched, partners, with_partners

__all__ = [
    "FIRST_FRAME",
    "SIGMA",
    "SILENCE_DB",
    "THRESHOLD",
    "THRESHOLDS",
    "Alignment",
    "Clip",
    "Summary",
    "Sweep",
    "align",
    "angle_change_rate",
    "angle_change_rates",
    "audio_onsets",
    "make_clips",
    "mean_angle_change",
    "mismatched",
    "motion_beats",
    "summary",
    "sweep",
]

THRESHOLDS = np.arange(1, 31) / 100  # of Figure 3


class Summary(NamedTuple):
    """Means over the clips that are not silent, each clip one vote; NaN without such clips.

    Attributes:
        recall, precision, f: as in `Alignment`.
        mismatched: F with other clips' sound, the chance level.
        gain: F minus `mismatched`, the headline number.
        pooled_recall, pooled_precision, pooled_f: the same of all onsets and all motion beats, each one vote.
        num_used, num_silent: clips with and without onsets.
        num_still: clips without motion beats among those used, which score 0.
        num_silent_still: clips without motion beats among the silent ones.
        onsets_per_second, beats_per_second: of the clips used.
        silent_beats_per_second: motion beats per second in silence.
    """

    recall: float
    precision: float
    f: float
    mismatched: float
    gain: float
    pooled_recall: float
    pooled_precision: float
    pooled_f: float
    num_used: int
    num_silent: int
    num_still: int
    num_silent_still: int
    onsets_per_second: float
    beats_per_second: float
    silent_beats_per_second: float


class Sweep(NamedTuple):
    """Scores by the threshold of the motion beats (Figure 3), of k thresholds and n clips.

    Attributes:
        thresholds: (k,).
        own, mismatched: (k,) mean F over the clips that are not silent, with the own and with others' sound.
        beats_per_second: (k,).
        own_by_clip, mismatched_by_clip: (k, n) what they are the means of, for intervals.
    """

    thresholds: np.ndarray
    own: np.ndarray
    mismatched: np.ndarray
    beats_per_second: np.ndarray
    own_by_clip: np.ndarray
    mismatched_by_clip: np.ndarray


def summary(alignment: Alignment, floor: np.ndarray) -> Summary:
    """Means over clips, pooled values, counts and rates.

    Args:
        alignment: of n clips.
        floor: (n,) their F with mismatched speech. The headline number is the mean of `alignment.f - floor`.
    """
    is_silent = alignment.is_silent
    used, silent = alignment.take(~is_silent), alignment.take(is_silent)
    recall, precision = used.heard.sum(), used.meant.sum()
    pooled_recall = _ratio(recall, used.num_onsets.sum())
    pooled_precision = _ratio(precision, used.num_beats.sum()) if used.num_beats.any() else 0 * pooled_recall
    return Summary(
        recall=_mean(used.recall),
        precision=_mean(used.precision),
        f=_mean(used.f),
        mismatched=_mean(floor[~is_silent]),
        gain=_mean(alignment.f - floor),
        pooled_recall=pooled_recall,
        pooled_precision=pooled_precision,
        pooled_f=float(harmonic_mean(np.array(pooled_recall), np.array(pooled_precision))),
        num_used=len(used.f),
        num_silent=len(silent.f),
        num_still=int(np.sum(used.num_beats == 0)),
        num_silent_still=int(np.sum(silent.num_beats == 0)),
        onsets_per_second=_ratio(used.num_onsets.sum(), used.seconds.sum()),
        beats_per_second=_ratio(used.num_beats.sum(), used.seconds.sum()),
        silent_beats_per_second=_ratio(silent.num_beats.sum(), silent.seconds.sum()),
    )


def sweep(
    rates: Sequence[np.ndarray] | np.ndarray,
    onsets: Sequence[np.ndarray],
    sources: Sequence[str | int] | np.ndarray,
    fps: float | np.ndarray,
    *,
    thresholds: np.ndarray = THRESHOLDS,
    first_frame: int = FIRST_FRAME,
    num: int = 5,
    seed: int = 0,
    sigma: float = SIGMA,
) -> Sweep:
    """F with the own and with mismatched speech for a range of thresholds, as in Figure 3.

    Args:
        rates, onsets, fps, first_frame: as for `make_clips`.
        sources, num, seed: as for `mismatched`; the other clips are the same for all thresholds.
        thresholds: (k,) of the motion beats.
        sigma: seconds.
    """
    others, own, floor, summaries = None, [], [], []
    for threshold in thresholds:
        clips = make_clips(rates, onsets, fps, first_frame=first_frame, threshold=threshold)
        others = partners(clips, sources, num=num, seed=seed) if others is None else others
        alignment = align(clips, sigma=sigma)
        own.append(alignment.f)
        floor.append(np.where(alignment.is_silent, np.nan, with_partners(clips, others, sigma=sigma)))
        summaries.append(summary(alignment, floor[-1]))
    return Sweep(
        thresholds=np.asarray(thresholds),
        own=np.array([each.f for each in summaries]),
        mismatched=np.array([each.mismatched for each in summaries]),
        beats_per_second=np.array([each.beats_per_second for each in summaries]),
        own_by_clip=np.array(own),
        mismatched_by_clip=np.array(floor),
    )


def _mean(values: np.ndarray) -> float:
    values = values[~np.isnan(values)]
    return float(values.mean()) if len(values) else float("nan")


def _ratio(total: float, count: float) -> float:
    return float(total / count) if count else float("nan")
