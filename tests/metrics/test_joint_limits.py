"""Angles that the training motion never has are counted, angle by angle and frame by frame."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from ha2g_jax.metrics import kinematics
from ha2g_jax.skeleton import joint_angles, load_skeleton, normalize

RNG = np.random.default_rng(0)
TRAINING = np.stack([np.linspace(0, 1, 1001), np.linspace(1, 3, 1001)], axis=1)
LIMITS = kinematics.training_limits(TRAINING)


def violations(angles, limits=LIMITS, **options) -> kinematics.Violations:
    return kinematics.violations(kinematics.violation_counts(angles, limits, **options))


def test_limits_by_hand():
    np.testing.assert_allclose(LIMITS.low, [0.001, 1.002])
    np.testing.assert_allclose(LIMITS.high, [0.999, 2.998])


def test_violations_by_hand():
    angles = np.tile([0.5, 2.0], (14, 1))
    angles[:4] = 9  # seed frames
    angles[5, 0], angles[6, 0], angles[6, 1], angles[7, 1] = -0.1, 1.2, 3.05, 9
    angles[8] = [0.001, 2.998]  # on the limits
    found = violations(angles)
    assert found == pytest.approx((0.2, 0.2, 0, 0.3))


def test_few_of_the_training_frames_violate_their_own_limits():
    found = violations(RNG.permutation(TRAINING), first_frame=0)
    assert found.mean == pytest.approx(0.002, abs=1e-4)


def test_counts_of_clips_add_up():
    clips = [RNG.normal(1, 1, (frames, 2)) for frames in (9, 20, 3, 30)]
    counts = np.stack([kinematics.violation_counts(clip, LIMITS) for clip in clips])
    together = np.concatenate([clip[4:] for clip in clips])
    found = kinematics.violations(counts.sum(axis=0))
    assert found == violations(together, first_frame=0)
    assert 0 < found.mean < found.any < 1


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_turning_the_body_changes_nothing(seed):
    skeleton, rng = load_skeleton("ted_expressive"), np.random.default_rng(seed)
    directions = normalize(skeleton.mean_directions + rng.normal(0, 0.3, (30, skeleton.num_bones, 3)))
    limits = kinematics.training_limits(joint_angles(skeleton, directions[:20]))
    turned = directions @ Rotation.from_rotvec(rng.normal(size=3)).as_matrix().T
    expected = violations(joint_angles(skeleton, directions), limits)
    assert expected.any > 0
    found = violations(joint_angles(skeleton, turned), limits)
    assert found == pytest.approx(expected)


def test_motion_that_stands_still_is_within_limits_of_its_own():
    still = np.full((30, 2), 0.7)
    assert violations(still, kinematics.training_limits(still)) == (0, 0, 0, 0)


def test_undefined_without_frames():
    found = violations(np.zeros((4, 2)))
    assert np.isnan([found.mean, found.worst, found.any]).all()


def test_inputs_are_not_modified():
    angles = RNG.normal(size=(20, 2))
    before = [x.tobytes() for x in (angles, TRAINING)]
    violations(angles, kinematics.training_limits(TRAINING))
    assert [x.tobytes() for x in (angles, TRAINING)] == before
