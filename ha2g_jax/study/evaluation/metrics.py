"""The metrics of an evaluation: how each is called and printed, and which way it was once thought to be better."""

from typing import NamedTuple

HIGHER, LOWER, NEITHER = 1, -1, 0


class Metric(NamedTuple):
    """A column of the table.

    Attributes:
        title: above the column, with the unit.
        group: the part of the table that it stands in.
        digits: after the point.
        better: the direction that is taken for the better one where the metric is used. It is never printed, a value
            is good when it is close to ground truth's; but a sanity row that goes further in that direction than
            ground truth shows that the metric does not measure quality, and is reported.
    """

    title: str
    group: str
    digits: int
    better: int


BEATS, LIKENESS, MOVEMENT, REFERENCE = (
    "Beats against the speech",
    "Motion as a whole",
    "Movement",
    "Errors of reconstruction, not quality",
)

FGD, FGD_SEEDED = "fgd", "fgd_seeded"
METRICS = {
    "beat_gain": Metric("beat gain", BEATS, 3, HIGHER),
    "beat_f": Metric("F", BEATS, 3, HIGHER),
    "beat_f_mismatched": Metric("F mismatched", BEATS, 3, NEITHER),
    "beat_recall": Metric("R", BEATS, 3, HIGHER),
    "beat_precision": Metric("Q", BEATS, 3, HIGHER),
    "beats_per_second": Metric("beats/s", BEATS, 2, NEITHER),
    "beats_per_second_in_silence": Metric("beats/s silent", BEATS, 2, NEITHER),
    "beat_align": Metric("BEAT alignment", BEATS, 3, HIGHER),
    FGD: Metric("FGD", LIKENESS, 3, LOWER),
    FGD_SEEDED: Metric("FGD (seeded)", LIKENESS, 3, LOWER),
    "diversity_l1": Metric("diversity L1", LIKENESS, 2, HIGHER),
    "diversity_l2": Metric("diversity L2", LIKENESS, 2, HIGHER),
    "multimodality": Metric("multimodality L1", LIKENESS, 2, HIGHER),
    "l1_diversity": Metric("L1 diversity", LIKENESS, 2, HIGHER),
    "speed_hellinger": Metric("speed Hellinger", LIKENESS, 3, LOWER),
    "acceleration": Metric("acc. m/s²", MOVEMENT, 2, NEITHER),
    "acceleration_ratio": Metric("acc. / truth", MOVEMENT, 2, NEITHER),
    "jerk": Metric("jerk m/s³", MOVEMENT, 1, NEITHER),
    "jerk_ratio": Metric("jerk / truth", MOVEMENT, 2, NEITHER),
    "limits_mean": Metric("beyond limits", MOVEMENT, 3, LOWER),
    "limits_worst": Metric("worst angle", MOVEMENT, 3, LOWER),
    "limits_any": Metric("any angle", MOVEMENT, 3, LOWER),
    "seam_velocity": Metric("seam velocity", MOVEMENT, 2, LOWER),
    "seam_acceleration": Metric("seam acc.", MOVEMENT, 2, LOWER),
    "joint_mae": Metric("joint MAE m", REFERENCE, 4, LOWER),
    "pck": Metric("PCK", REFERENCE, 3, HIGHER),
}

LEGACY = "Legacy rules (legacy_v1), to be compared with old tables only"
LEGACY_METRICS = {
    "legacy_fgd": Metric("FGD", LEGACY, 3, LOWER),
    "legacy_feature_distance": Metric("feature L1", LEGACY, 3, LOWER),
    "legacy_bc_paper": Metric("BC paper", LEGACY, 3, HIGHER),
    "legacy_bc_fixed": Metric("BC fixed", LEGACY, 3, HIGHER),
    "legacy_diversity": Metric("Diversity", LEGACY, 2, HIGHER),
}

TRUTH, HALF, MEAN_POSE, FROZEN, MISMATCHED, JITTER, SMOOTHED = (
    "ground truth",
    "ground truth, other half",
    "mean pose",
    "frozen",
    "mismatched speech",
    "white jitter",
    "smoothed ground truth",
)
SANITY_ROWS = (TRUTH, HALF, MEAN_POSE, FROZEN, MISMATCHED, JITTER, SMOOTHED)
