"""No metric writes into what it is given."""

import numpy as np
import pytest

from ha2g_jax.metrics import kinematics, legacy, reconstruction, sanity, seams
from ha2g_jax.metrics.beats import rests
from ha2g_jax.metrics.beats.alignment import align, mismatched
from ha2g_jax.metrics.beats.stops import angle_change_rate, make_clips, mean_angle_change
from ha2g_jax.skeleton import load_skeleton

SKELETON = load_skeleton("ted_gesture")
FPS = 15


def read_only(array: np.ndarray) -> np.ndarray:
    array.flags.writeable = False
    return array


RANDOM = np.random.default_rng(0)
CLIPS = [read_only(SKELETON.mean_directions + np.cumsum(RANDOM.normal(0, 0.05, (34, 9, 3)), axis=0)) for _ in range(4)]
ONSETS = [read_only(RANDOM.uniform(0, 2, 5)) for _ in CLIPS]


def score_beats():
    clips = make_clips([angle_change_rate(SKELETON, clip) for clip in CLIPS], ONSETS, FPS)
    return align(clips), mismatched(clips, np.arange(4))


def score_rests():
    return rests.beat_align(CLIPS[0], ONSETS[0], read_only(rests.mean_speeds(CLIPS, FPS)), FPS)


def score_speeds():
    return kinematics.speed_counts(CLIPS[1], read_only(kinematics.speed_edges(CLIPS, FPS)), FPS)


def count_violations():
    return kinematics.violation_counts(CLIPS[0][:, :, 0], kinematics.training_limits(CLIPS[1][:, :, 0]))


STACKED = read_only(np.stack(CLIPS))
METRICS = {
    "beats": score_beats,
    "rests": score_rests,
    "speeds": score_speeds,
    "violations": count_violations,
    "angle change": lambda: mean_angle_change(SKELETON, CLIPS),
    "acceleration": lambda: kinematics.acceleration(CLIPS[0], FPS),
    "jerk": lambda: kinematics.jerk(CLIPS[0], FPS),
    "spread": lambda: kinematics.l1_diversity(CLIPS[0]),
    "canonical correlation": lambda: reconstruction.canonical_pairs(CLIPS[:2], CLIPS[2:], ["a", "b"]),
    "joint error": lambda: reconstruction.joint_mae(CLIPS[0], CLIPS[1]),
    "acceleration error": lambda: reconstruction.acceleration_error(CLIPS[0], CLIPS[1], FPS),
    "keypoints": lambda: reconstruction.pck(CLIPS[0], CLIPS[1]),
    "sanity": lambda: sanity.rows(CLIPS, read_only(SKELETON.mean_directions.copy())),
    "seams": lambda: seams.seam_score([CLIPS[0]], [read_only(np.array([20, 10]))], FPS),
    "legacy errors": lambda: legacy.legacy_errors(STACKED[:1], STACKED[1:2]),
    "legacy beats": lambda: legacy.legacy_bc(SKELETON, STACKED, ONSETS),
}


@pytest.mark.parametrize("metric", METRICS.values(), ids=METRICS)
def test_inputs_are_not_modified(metric):
    metric()
