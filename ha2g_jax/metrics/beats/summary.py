"""Beat alignment of a set of clips: means, pooled values, counts, and the sweep over thresholds of Figure 3."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ha2g_jax.metrics.beats.alignment import Alignment, align, harmonic_mean
from ha2g_jax.metrics.beats.consistency import beat_consistency, consistency
from ha2g_jax.metrics.beats.mismatched import partners, with_partners
from ha2g_jax.metrics.beats.stops import FIRST_FRAME, make_clips
from ha2g_jax.metrics.beats.times import SIGMA

THRESHOLDS = np.arange(1, 31) / 100  # of Figure 3


class Summary(NamedTuple):
    """Means over the clips that are not silent, each clip one vote; NaN without such clips.

    Attributes:
        recall, precision, f: means of those of `Alignment`.
        mismatched: mean F with the sound of other clips, the chance level.
        gain: F minus `mismatched`, the number to report.
        pooled_recall, pooled_precision, pooled_f: recall, precision and F of all onsets and beats, each one vote.
        num_used, num_silent: numbers of clips with and without onsets.
        num_still: number of clips without motion beats among those used, which score 0.
        num_silent_still: number of clips without motion beats among the silent ones.
        onsets_per_second, beats_per_second: rates in the clips used.
        silent_beats_per_second: motion beats per second in silent clips.
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
        thresholds: (k,) least rises of the angle change rate.
        consistency: (k,) BC of the paper (Eq. 11), which Figure 3 shows.
        own, mismatched: (k,) mean F over the clips that are not silent, with the own and with mismatched speech.
        beats_per_second: (k,) motion beats per second.
        own_by_clip, mismatched_by_clip: (k, n) F of each clip, for intervals.
    """

    thresholds: np.ndarray
    consistency: np.ndarray
    own: np.ndarray
    mismatched: np.ndarray
    beats_per_second: np.ndarray
    own_by_clip: np.ndarray
    mismatched_by_clip: np.ndarray


def summary(alignment: Alignment, floor: np.ndarray) -> Summary:
    """Compute means over clips, pooled values, counts and rates.

    Args:
        alignment: alignment of n clips.
        floor: (n,) F of the clips with mismatched speech. The number to report is the mean of `alignment.f - floor`.
    """
    is_silent = alignment.is_silent
    used, silent = alignment.take(~is_silent), alignment.take(is_silent)
    recall, precision = used.onset_sum.sum(), used.beat_sum.sum()
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
    recordings: Sequence[str | int] | np.ndarray,
    fps: float | np.ndarray,
    *,
    thresholds: np.ndarray = THRESHOLDS,
    first_frame: int = FIRST_FRAME,
    num: int = 5,
    seed: int = 0,
    sigma: float = SIGMA,
) -> Sweep:
    """Compute BC (Figure 3), and F with the own and with mismatched speech, for a range of thresholds.

    Args:
        rates, onsets, fps, first_frame: arguments of `make_clips`.
        recordings, num, seed: arguments of `mismatched`; the other clips are the same for all thresholds.
        thresholds: (k,) least rises of the angle change rate on both sides of a motion beat.
        sigma: width of the kernel in seconds.
    """
    others, paper, own, floor, summaries = None, [], [], [], []
    for threshold in thresholds:
        clips = make_clips(rates, onsets, fps, first_frame=first_frame, threshold=threshold)
        others = partners(clips, recordings, num=num, seed=seed) if others is None else others
        aligned = consistency(rates, onsets, fps, first_frame=first_frame, threshold=threshold, sigma=sigma)
        paper.append(beat_consistency(aligned))
        alignment = align(clips, sigma=sigma)
        own.append(alignment.f)
        floor.append(np.where(alignment.is_silent, np.nan, with_partners(clips, others, sigma=sigma)))
        summaries.append(summary(alignment, floor[-1]))
    return Sweep(
        thresholds=np.asarray(thresholds),
        consistency=np.array(paper),
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
