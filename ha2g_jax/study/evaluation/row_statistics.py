"""All scores of a row of an evaluation but those of latents, each as a function of how often a source is drawn.

A score of a draw of sources is put together from sums by source, so that a thousand draws take milliseconds. The draws
of two rows are of the same sources, so that differences between rows are paired.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ha2g_jax.metrics import beat_align, beat_alignment, joint_limits, kinematics, seams, srgr
from ha2g_jax.metrics.beat_alignment import Alignment
from ha2g_jax.metrics.joint_limits import Limits
from ha2g_jax.skeleton import Skeleton, directions_to_positions, joint_angles
from ha2g_jax.study.evaluation.latent_statistics import Statistic
from ha2g_jax.study.evaluation.performance import SEED_FRAMES
from ha2g_jax.study.evaluation.rows import Row, Rows

NUM_MISMATCHES = 5  # other clips whose sound makes the chance level of a clip

_RIGID = np.deg2rad(0.5)  # range of an angle that does not bend in the training motion


class Yardstick(NamedTuple):
    """What all rows are measured with, taken from the training motion, or from ground truth where there is none.

    Attributes:
        skeleton: of all motion.
        fps: frames per second of all motion.
        angle_change: (pairs,) usual change of each angle over pi per frame.
        limits: of the angles.
        speeds: (joints,) mean speed of the joints that BEAT's alignment looks at, in m/s.
        speed_edges: (joints, bins) of the histograms of speeds, at quantiles of ground truth.
        seed: of mismatched speech.
    """

    skeleton: Skeleton
    fps: float
    angle_change: np.ndarray
    limits: Limits
    speeds: np.ndarray
    speed_edges: np.ndarray
    seed: int


class RowScores(NamedTuple):
    """What is found of a row.

    Attributes:
        statistics: its scores by the names of `evaluation_metrics.METRICS`.
        counts: of clips by what was heard and seen in them, empty without sound.
        speed_counts: (sources, joints, bins) histograms of speeds.
    """

    statistics: dict[str, Statistic]
    counts: dict[str, float]
    speed_counts: np.ndarray


def mean_directions(clips: Sequence[np.ndarray]) -> np.ndarray:
    """The mean (bones, 3) over all frames of clips (T, bones, 3); not of unit length."""
    total = sum(np.sum(clip, axis=0, dtype=np.float64) for clip in clips)
    return np.asarray(total) / sum(map(len, clips))


def make_yardstick(
    skeleton: Skeleton, training: Sequence[np.ndarray], truth: Sequence[np.ndarray], fps: float, seed: int
) -> Yardstick:
    """The yardstick of training clips (T, bones, 3) and of ground truth."""
    joints = beat_align.upper_body(skeleton)
    angles = np.concatenate([joint_angles(skeleton, np.asarray(clip, np.float64)) for clip in training])
    positions = [_positions(skeleton, clip) for clip in training]
    return Yardstick(
        skeleton=skeleton,
        fps=fps,
        angle_change=beat_alignment.mean_angle_change(skeleton, training),
        limits=_limits(angles),
        speeds=beat_align.mean_speeds([clip[:, joints] for clip in positions], fps, first_frame=0),
        speed_edges=kinematics.speed_edges(
            [_positions(skeleton, clip) for clip in truth], fps, first_frame=SEED_FRAMES
        ),
        seed=seed,
    )


def measure(row: Row, truth: Row, rows: Rows, yardstick: Yardstick) -> RowScores:
    """The scores of a row beside ground truth."""
    members = rows.members[row.numbers]
    beats, counts = _beats(row, rows, members, yardstick)
    values, limits, speed_counts = _measure_clips(row, truth, members, rows.num_sources, yardstick)
    frames = np.array([len(directions) - SEED_FRAMES for directions in row.directions], float)
    for name, found in values.items():
        if not np.isnan(found).all():
            # A clip is one vote in what is asked of its sound, as in the rest of beat alignment.
            weights = None if name == "beat_align" else frames
            beats[name] = _mean(found, members, rows.num_sources, weights)
    for name, field in (("limits_mean", "mean"), ("limits_worst", "worst"), ("limits_any", "any")):
        beats[name] = _limit_share(limits, field)
    return RowScores(beats | _seams(row, members, rows.num_sources, yardstick.fps), counts, speed_counts)


def speed_distance(counts: np.ndarray, reference: np.ndarray) -> Statistic:
    """Hellinger distance of two histograms (sources, joints, bins)."""
    return lambda drawn: kinematics.histogram_distance(
        np.tensordot(drawn, counts, axes=1), np.tensordot(drawn, reference, axes=1)
    )


def ratio(first: Statistic, second: Statistic) -> Statistic:
    """One score over another of the same draw; NaN where that is 0."""

    def statistic(counts: np.ndarray) -> float:
        divisor = second(counts)
        return first(counts) / divisor if divisor else np.nan

    return statistic


def difference(first: Statistic, second: Statistic) -> Statistic:
    """One score less another of the same draw."""
    return lambda counts: first(counts) - second(counts)


def _limits(angles: np.ndarray) -> Limits:
    """Limits of angles (frames, pairs); none where an angle is rigid, which the least change would break."""
    limits = joint_limits.training_limits(angles)
    is_rigid = limits.high - limits.low < _RIGID
    return limits._replace(low=np.where(is_rigid, -np.inf, limits.low), high=np.where(is_rigid, np.inf, limits.high))


def _mean(values: np.ndarray, members: np.ndarray, num_sources: int, weights: np.ndarray | None = None) -> Statistic:
    """Mean over clips (n,) of those whose value is defined."""
    weights = np.where(np.isnan(values), 0.0, 1.0 if weights is None else weights)
    sums = np.bincount(members, weights * np.where(np.isnan(values), 0, values), num_sources)
    totals = np.bincount(members, weights, num_sources)

    def statistic(counts: np.ndarray) -> float:
        total = counts @ totals
        return float(counts @ sums / total) if total > 0 else np.nan

    return statistic


def _beats(
    row: Row, rows: Rows, members: np.ndarray, yardstick: Yardstick
) -> tuple[dict[str, Statistic], dict[str, float]]:
    """Beat alignment of the clips that have sound, and their counts."""
    heard = [index for index, onsets in enumerate(row.onsets) if onsets is not None]
    if not heard:
        return {}, {}
    rates = beat_alignment.angle_change_rates(
        yardstick.skeleton, [row.directions[index] for index in heard], yardstick.angle_change
    )
    onsets = [np.asarray(row.onsets[index], np.float64) for index in heard]
    clips = beat_alignment.make_clips(rates, onsets, yardstick.fps, first_frame=SEED_FRAMES)
    alignment = beat_alignment.align(clips)
    own_sources = rows.sources[row.numbers[heard]]
    floor = beat_alignment.mismatched(clips, own_sources, num=NUM_MISMATCHES, seed=yardstick.seed)
    floor = np.where(alignment.is_silent, np.nan, floor)
    sources, count = members[heard], rows.num_sources
    statistics = {
        "beat_gain": _mean(alignment.f - floor, sources, count),
        "beat_f": _mean(alignment.f, sources, count),
        "beat_f_mismatched": _mean(floor, sources, count),
        "beat_recall": _mean(alignment.recall, sources, count),
        "beat_precision": _mean(alignment.precision, sources, count),
        "beats_per_second": _rate(alignment, ~alignment.is_silent, sources, count),
        "beats_per_second_in_silence": _rate(alignment, alignment.is_silent, sources, count),
    }
    summary = beat_alignment.summary(alignment, floor)
    counts = {
        name: getattr(summary, name)
        for name in ("num_used", "num_silent", "num_still", "num_silent_still", "onsets_per_second", "pooled_f")
    }
    return statistics, counts


def _rate(alignment: Alignment, chosen: np.ndarray, sources: np.ndarray, count: int) -> Statistic:
    """Motion beats per second of some clips."""
    rates = np.where(chosen, alignment.num_beats / np.maximum(alignment.seconds, 1e-9), np.nan)
    return _mean(rates, sources, count, alignment.seconds)


def _measure_clips(
    row: Row, truth: Row, members: np.ndarray, num_sources: int, yardstick: Yardstick
) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray]:
    """Values by clip, and by source the counts of angles beyond their limits and of speeds."""
    skeleton, fps = yardstick.skeleton, yardstick.fps
    joints = beat_align.upper_body(skeleton)
    names = ("beat_align", "acceleration", "jerk", "l1_diversity", "joint_mae", "pck")
    values = {name: np.full(len(row.directions), np.nan) for name in names}
    limits = np.zeros((num_sources, 2, 2 + len(skeleton.angle_pairs)))
    speed_counts = np.zeros((num_sources, skeleton.num_joints, yardstick.speed_edges.shape[-1] + 2))
    for index, (directions, number, onsets) in enumerate(zip(row.directions, row.numbers, row.onsets, strict=True)):
        positions, source = _positions(skeleton, directions), members[index]
        values["acceleration"][index] = kinematics.acceleration(positions, fps, first_frame=SEED_FRAMES)
        values["jerk"][index] = kinematics.jerk(positions, fps, first_frame=SEED_FRAMES)
        values["l1_diversity"][index] = kinematics.l1_diversity(directions, first_frame=SEED_FRAMES)
        angles = joint_angles(skeleton, np.asarray(directions, np.float64))
        limits[source] += joint_limits.violation_counts(angles, yardstick.limits, first_frame=SEED_FRAMES)
        speed_counts[source] += kinematics.speed_counts(positions, yardstick.speed_edges, fps, first_frame=SEED_FRAMES)
        if onsets is not None:
            values["beat_align"][index] = beat_align.beat_align(
                positions[:, joints], onsets, yardstick.speeds, fps, first_frame=SEED_FRAMES
            )
        if row.has_counterpart:
            true = positions if row is truth else _positions(skeleton, truth.directions[number])
            values["joint_mae"][index] = np.mean(np.abs(positions - true)[SEED_FRAMES:])
            values["pck"][index] = srgr.srgr(positions, true, first_frame=SEED_FRAMES)
    return values, limits, speed_counts


def _limit_share(limits: np.ndarray, field: str) -> Statistic:
    def statistic(counts: np.ndarray) -> float:
        drawn = np.tensordot(counts, limits, axes=1)
        return float(getattr(joint_limits.shares(drawn[None]).quantiles, field))

    return statistic


def _seams(row: Row, members: np.ndarray, count: int, fps: float) -> dict[str, Statistic]:
    """Jumps at the borders of windows over those inside, where borders are known."""
    sums = np.zeros((2, 2, count))  # outside and inside, velocity and acceleration
    for directions, borders, source in zip(row.directions, row.borders, members, strict=True):
        if not len(borders):
            continue
        jumps = seams.stretch_jumps(directions, fps, first_frame=SEED_FRAMES)
        for group in seams.border_groups(jumps, np.sort(borders)):
            sums[0, :, source] += group[0]
            sums[1, :, source] += group[1:].mean(axis=0)
    if not sums.any():
        return {}
    return {name: _sum_ratio(*sums[:, kind]) for kind, name in enumerate(("seam_velocity", "seam_acceleration"))}


def _sum_ratio(first: np.ndarray, second: np.ndarray) -> Statistic:
    def statistic(counts: np.ndarray) -> float:
        divisor = counts @ second
        return float(counts @ first / divisor) if divisor > 0 else np.nan

    return statistic


def _positions(skeleton: Skeleton, directions: np.ndarray) -> np.ndarray:
    return directions_to_positions(skeleton, np.asarray(directions, np.float64))
