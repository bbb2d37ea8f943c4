"""Alignment of the motion beats of a row with the speech, its registered metrics, and counts of clips."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ha2g_jax.metrics.beats import rests
from ha2g_jax.metrics.beats.alignment import Alignment, align, mismatched
from ha2g_jax.metrics.beats.stops import angle_change_rates, consistency, make_clips, mean_angle_change
from ha2g_jax.metrics.metric import BEATS, Metric, Statistic
from ha2g_jax.metrics.row import Reference, Row, mean_by_recording, mean_over_clips, ratio_of_sums
from ha2g_jax.skeleton import directions_to_positions

NUM_MISMATCHES = 5  # other clips whose sound makes the chance level of a clip


class RowAlignment(NamedTuple):
    """Beat alignment of the motions of a row that have sound.

    Attributes:
        own: alignment of n motions with their own sound.
        paper: the same with the motion beats of the paper, for BC.
        floor: (n,) F with the sound of other recordings, NaN for a silent clip.
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
    clips = make_clips(rates, onsets, reference.fps)
    own = align(clips)
    true = [np.asarray(reference.onsets[number], np.float64) for number in numbers]
    sound = clips if row.has_counterpart else make_clips(rates, true, reference.fps)
    floor = mismatched(sound, reference.recordings[numbers], num=NUM_MISMATCHES, seed=reference.seed)
    floor = np.where(own.is_silent, np.nan, floor)
    paper = consistency(rates, onsets, reference.fps)
    return RowAlignment(own, paper, floor, row.members[with_sound], reference.num_recordings)


def clip_counts(row: Row) -> dict[str, float]:
    """Return the numbers of scored, silent and still clips of a row, and its onsets per second; empty without sound."""
    found = row.once(row_alignment)
    if found is None:
        return {}
    used = found.own.take(~found.own.is_silent)
    seconds = used.seconds.sum()
    return {
        "num_used": len(used.f),
        "num_silent": int(found.own.is_silent.sum()),
        "num_still": int(np.sum(used.num_beats == 0)),
        "onsets_per_second": float(used.num_onsets.sum() / seconds) if seconds else np.nan,
    }


def _usual_change(reference: Reference) -> np.ndarray:
    return mean_angle_change(reference.skeleton, reference.training)


def _usual_speeds(reference: Reference) -> np.ndarray:
    joints = rests.upper_body(reference.skeleton)
    positions = [
        directions_to_positions(reference.skeleton, np.asarray(clip, np.float64)) for clip in reference.training
    ]
    return rests.mean_speeds([clip[:, joints] for clip in positions], reference.fps)


def _mean(values: Callable[[RowAlignment], np.ndarray]) -> Callable[[Row], Statistic | None]:
    """Return a measure: the mean of one value for each clip with sound, all clips with equal weight."""

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
    """Return BC of a row, a mean over onsets and not over clips; None where no clip has an onset."""
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
        np.nan if onsets is None else rests.beat_align(positions[:, joints], onsets, speeds, reference.fps)
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
