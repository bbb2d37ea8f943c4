"""The old rules are scored in a section of their own, and show what is wrong with them."""

import dataclasses

import numpy as np
import pytest

from ha2g_jax.errors import UserError
from ha2g_jax.evaluation.clip_result import ClipResult
from ha2g_jax.evaluation.evaluate import evaluate
from ha2g_jax.metrics.legacy import legacy_distance, legacy_errors
from ha2g_jax.metrics.sanity import HALF, JITTER, MEAN_POSE, SANITY_ROWS


@pytest.fixture(scope="module")
def legacy(skeleton, perform, features):
    def with_clicks(clip: ClipResult) -> ClipResult:
        audio = np.zeros(16000 * 8, np.float32)
        for onset in clip.onsets if clip.onsets is not None else ():
            start = int(onset * 16000)
            audio[start : start + 400] = np.sin(np.arange(400) * 0.3)[: len(audio) - start]
        return dataclasses.replace(clip, audio=audio)

    reference = [with_clicks(clip) for clip in perform(12, 119)]
    late = perform(12, 119, delay=0.25)
    for clip in (*reference, *late):  # nothing is written into what is given
        clip.directions.setflags(write=False)
    return evaluate({"late": late[::-1]}, reference, skeleton, autoencoder=features, legacy=True, draws=2)


def test_it_is_apart_and_complete(legacy):
    rows = legacy["legacy_v1"]["rows"]
    assert set(rows) == {"late", *SANITY_ROWS} - {HALF}
    assert not any(key.startswith("legacy") for row in legacy["rows"].values() for key in row)
    assert set(rows["late"]) == {
        *("legacy_bc_paper", "legacy_bc_fixed", "legacy_fgd", "legacy_diversity", "legacy_feature_distance"),
        *("legacy_joint_mae", "legacy_acceleration"),
    }


def test_whole_batches_from_the_first_frame_are_scored(legacy, skeleton, perform, features):
    windows = [
        np.stack([clip.directions[start : start + 34] for clip in clips for start in (0, 34, 68)])
        for clips in (perform(12, 119, delay=0.25), perform(12, 119))
    ]
    late, true = (features(each)[:32] for each in windows)  # 36 windows, one batch of 32
    expected = legacy_distance(late, true)
    assert legacy["legacy_v1"]["rows"]["late"]["legacy_fgd"]["value"] == pytest.approx(expected, rel=1e-6)
    errors = legacy_errors(*windows)
    assert legacy["legacy_v1"]["rows"]["late"]["legacy_joint_mae"]["value"] == pytest.approx(errors.joint_mae, rel=1e-6)
    found = legacy["legacy_v1"]["rows"]["late"]["legacy_acceleration"]["value"]
    assert found == pytest.approx(errors.acceleration, rel=1e-6)


def test_old_rules_pass_over_still_motion_and_favour_jitter(legacy):
    rows = legacy["legacy_v1"]["rows"]
    assert rows[MEAN_POSE]["legacy_bc_fixed"]["value"] is None
    assert rows[JITTER]["legacy_bc_fixed"]["value"] > rows["late"]["legacy_bc_fixed"]["value"]


def test_another_frame_rate_is_refused(skeleton, perform):
    """The old rules count frames of 15 per second."""
    clips = [dataclasses.replace(clip, fps=30.0) for clip in perform(2)]
    with pytest.raises(UserError, match="15 frames per second, not of 30"):
        evaluate({"late": clips}, clips, skeleton, legacy=True)
