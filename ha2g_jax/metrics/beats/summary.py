"""Beats of a set of clips: the registered metrics of a row, means and pooled values, and the sweep of Figure 3."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from ha2g_jax.metrics.beats import rests
from ha2g_jax.metrics.beats.alignment import Alignment, align, harmonic_mean, mismatched, partners, with_partners
from ha2g_jax.metrics.beats.stops import (
    FIRST_FRAME,
    angle_change_rates,
    beat_consistency,
    consistency,
    make_clips,
    mean_angle_change,
)
from ha2g_jax.metrics.metric import BEATS, Metric, Statistic
from ha2g_jax.metrics.row import SEED_FRAMES, Reference, Row, mean_by_recording, mean_over_clips, ratio_of_sums
from ha2g_jax.skeleton import directions_to_positions

NUM_MISMATCHES = 5  # other clips whose sound makes the chance level of a clip

THRESHOLDS = np.arange(1, 31) / 100  # of Figure 3


class RowAlignment(NamedTuple):
    """Beat alignment of the motions of a row that have sound.

    Attributes:
        own: alignment of n motions with their own sound.
        paper: the same by the motion beats of the paper, for BC.
        floor: (n,) F with mismatched speech, NaN for a silent clip.
        members: (n,) index of each motion's recording.
    """

    own: Alignment
    paper: Alignment
    floor: np.ndarray
    members: np.ndarray
    num_recordings: int


def row_alignment(row: Row) -> RowAlignment | None:
    """Align the motions of a row with their sound; None where no motion has sound."""
    with_sound = [index for index, onsets in enumerate(row.onsets) if onsets is not None]
    if not with_sound:
        return None
    reference, numbers = row.reference, row.numbers[with_sound]
    rates = angle_change_rates(
        reference.skeleton, [row.directions[index] for index in with_sound], reference.once(_usual_change)
    )
    onsets = [np.asarray(row.onsets[index], np.float64) for index in with_sound]
    clips = make_clips(rates, onsets, reference.fps, first_frame=SEED_FRAMES)
    own = align(clips)
    floor = mismatched(clips, reference.recordings[numbers], num=NUM_MISMATCHES, seed=reference.seed)
    floor = np.where(own.is_silent, np.nan, floor)
    paper = consistency(rates, onsets, reference.fps, first_frame=SEED_FRAMES)
    return RowAlignment(own, paper, floor, row.members[with_sound], reference.num_recordings)


def clip_counts(row: Row) -> dict[str, float]:
    """Return the numbers of silent, still and scored clips of a row, and rates; empty without sound."""
    found = row.once(row_alignment)
    if found is None:
        return {}
    values = summary(found.own, found.floor)
    names = ("num_used", "num_silent", "num_still", "num_silent_still", "onsets_per_second", "pooled_f")
    return {name: getattr(values, name) for name in names}


def _usual_change(reference: Reference) -> np.ndarray:
    return mean_angle_change(reference.skeleton, reference.training)


def _usual_speeds(reference: Reference) -> np.ndarray:
    joints = rests.upper_body(reference.skeleton)
    positions = [
        directions_to_positions(reference.skeleton, np.asarray(clip, np.float64)) for clip in reference.training
    ]
    return rests.mean_speeds([clip[:, joints] for clip in positions], reference.fps, first_frame=0)


def _mean(values: Callable[[RowAlignment], np.ndarray]) -> Callable[[Row], Statistic | None]:
    """Return a measure: the mean over clips with sound of one value each, every clip one vote."""

    def measure(row: Row) -> Statistic | None:
        found = row.once(row_alignment)
        return None if found is None else mean_by_recording(values(found), found.members, found.num_recordings)

    return measure


def _rate(is_silent: bool) -> Callable[[Row], Statistic | None]:
    """Return a measure: the motion beats per second of the clips with onsets, or of the silent ones."""

    def measure(row: Row) -> Statistic | None:
        found = row.once(row_alignment)
        if found is None:
            return None
        own = found.own
        rates = np.where(own.is_silent == is_silent, own.num_beats / np.maximum(own.seconds, 1e-9), np.nan)
        return mean_by_recording(rates, found.members, found.num_recordings, own.seconds)

    return measure


def _beat_consistency(row: Row) -> Statistic | None:
    """Return BC of a row: a mean over onsets, so that it has sums of its own; None where no clip has an onset."""
    found = row.once(row_alignment)
    if found is None or not found.paper.num_onsets.any():
        return None
    sums, counts = (
        np.bincount(found.members, values, found.num_recordings)
        for values in (found.paper.onset_sum, found.paper.num_onsets)
    )
    return ratio_of_sums(sums, counts)


def _rest_alignment(row: Row) -> Statistic | None:
    """Return the BEAT alignment of a row; None where no clip has an onset."""
    reference = row.reference
    joints, speeds = rests.upper_body(reference.skeleton), reference.once(_usual_speeds)
    values = [
        np.nan
        if onsets is None
        else rests.beat_align(positions[:, joints], onsets, speeds, reference.fps, first_frame=SEED_FRAMES)
        for positions, onsets in zip(row.positions, row.onsets, strict=True)
    ]
    return None if np.isnan(values).all() else mean_over_clips(row, values)


BEAT_METRICS = (
    Metric(
        "beat_gain", "beat gain", "", "higher", BEATS, 3, _mean(lambda found: found.own.f - found.floor), is_paired=True
    ),
    Metric("beat_f", "F", "", "higher", BEATS, 3, _mean(lambda found: found.own.f), is_paired=True),
    Metric("beat_f_mismatched", "F mismatched", "", "none", BEATS, 3, _mean(lambda found: found.floor)),
    Metric("beat_recall", "R", "", "higher", BEATS, 3, _mean(lambda found: found.own.recall)),
    Metric("beat_precision", "Q", "", "higher", BEATS, 3, _mean(lambda found: found.own.precision)),
    Metric("beat_consistency", "BC", "", "higher", BEATS, 3, _beat_consistency, is_paired=True),
    Metric("beats_per_second", "beats", "/s", "none", BEATS, 2, _rate(is_silent=False)),
    Metric("beats_per_second_in_silence", "silent beats", "/s", "none", BEATS, 2, _rate(is_silent=True)),
    Metric("beat_align", "BEAT alignment", "", "higher", BEATS, 3, _rest_alignment),
)


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
    """Scores by the threshold of the motion beats (Figure 3), of k thresholds.

    Attributes:
        thresholds: (k,) least rises of the angle change rate.
        consistency: (k,) BC of the paper (Eq. 11), which Figure 3 shows.
        own, mismatched: (k,) mean F over the clips that are not silent, with the own and with mismatched speech.
        beats_per_second: (k,) motion beats per second.
    """

    thresholds: np.ndarray
    consistency: np.ndarray
    own: np.ndarray
    mismatched: np.ndarray
    beats_per_second: np.ndarray


def summary(alignment: Alignment, floor: np.ndarray) -> Summary:
    """Compute means over clips, pooled values, counts and rates of an alignment of n clips and their F (n,) with
    mismatched speech.
    """
    is_silent = alignment.is_silent
    used, silent = alignment.take(~is_silent), alignment.take(is_silent)
    recall, precision = used.onset_sum.sum(), used.beat_sum.sum()
    pooled_recall = _ratio_or_nan(recall, used.num_onsets.sum())
    pooled_precision = _ratio_or_nan(precision, used.num_beats.sum()) if used.num_beats.any() else 0 * pooled_recall
    return Summary(
        recall=_mean_or_nan(used.recall),
        precision=_mean_or_nan(used.precision),
        f=_mean_or_nan(used.f),
        mismatched=_mean_or_nan(floor[~is_silent]),
        gain=_mean_or_nan(alignment.f - floor),
        pooled_recall=pooled_recall,
        pooled_precision=pooled_precision,
        pooled_f=float(harmonic_mean(np.array(pooled_recall), np.array(pooled_precision))),
        num_used=len(used.f),
        num_silent=len(silent.f),
        num_still=int(np.sum(used.num_beats == 0)),
        num_silent_still=int(np.sum(silent.num_beats == 0)),
        onsets_per_second=_ratio_or_nan(used.num_onsets.sum(), used.seconds.sum()),
        beats_per_second=_ratio_or_nan(used.num_beats.sum(), used.seconds.sum()),
        silent_beats_per_second=_ratio_or_nan(silent.num_beats.sum(), silent.seconds.sum()),
    )


def sweep(
    rates: Sequence[np.ndarray] | np.ndarray,
    onsets: Sequence[np.ndarray],
    recordings: Sequence[str | int] | np.ndarray,
    fps: float | np.ndarray,
    *,
    first_frame: int = FIRST_FRAME,
    num: int = 5,
    seed: int = 0,
) -> Sweep:
    """Compute BC (Figure 3), and F with the own and with mismatched speech, for a range of thresholds.

    The arguments are those of `make_clips` and `mismatched`; the other clips are the same for all thresholds.
    """
    others, paper, summaries = None, [], []
    for threshold in THRESHOLDS:
        clips = make_clips(rates, onsets, fps, first_frame=first_frame, threshold=threshold)
        others = partners(clips, recordings, num=num, seed=seed) if others is None else others
        aligned = consistency(rates, onsets, fps, first_frame=first_frame, threshold=threshold)
        paper.append(beat_consistency(aligned))
        alignment = align(clips)
        floor = np.where(alignment.is_silent, np.nan, with_partners(clips, others))
        summaries.append(summary(alignment, floor))
    return Sweep(
        thresholds=THRESHOLDS,
        consistency=np.array(paper),
        own=np.array([each.f for each in summaries]),
        mismatched=np.array([each.mismatched for each in summaries]),
        beats_per_second=np.array([each.beats_per_second for each in summaries]),
    )


def _mean_or_nan(values: np.ndarray) -> float:
    values = values[~np.isnan(values)]
    return float(values.mean()) if len(values) else float("nan")


def _ratio_or_nan(total: float, count: float) -> float:
    return float(total / count) if count else float("nan")
