"""The paper's three conditions, and the settings that hold their thresholds."""

import dataclasses
import inspect
import json

import numpy as np
import pytest

from ha2g_jax.errors import UserError
from ha2g_jax.importers.video import selection
from ha2g_jax.importers.video.settings import VideoSettings, from_pairs, read_settings
from ha2g_jax.skeleton import load_skeleton

SKELETON = load_skeleton("ted_expressive")


@pytest.mark.parametrize(("num_frames", "verdict"), [(149, "too short"), (150, "too short"), (151, None)])
def test_a_shot_is_longer_than_five_seconds(num_frames, verdict):
    assert selection.too_short(num_frames, 30, VideoSettings().min_seconds) == verdict


@pytest.mark.parametrize(("num_seen", "verdict"), [(50, "keypoints unseen"), (51, None), (0, "keypoints unseen")])
def test_all_keypoints_are_seen_in_more_than_half_of_the_frames(num_seen, verdict):
    confidence = np.ones((100, 43), np.float32)
    confidence[num_seen:, 17] = 0.3  # one finger joint is enough
    assert selection.unseen(confidence, 0.5, VideoSettings().min_visible) == verdict


def test_keypoints_are_to_be_seen_at_once():
    """Protects the reading of condition 1: each hand seen in 60 %, but never both, is not the 43 keypoints."""
    confidence = np.ones((100, 43), np.float32)
    confidence[:60, 20], confidence[40:, 30] = 0, 0
    assert selection.unseen(confidence, 0.5, 0.5) == "keypoints unseen"


def test_what_was_not_found_is_not_seen_whatever_the_threshold():
    assert selection.unseen(np.zeros((10, 43)), 0.0, 0.5) == "keypoints unseen"


@pytest.mark.parametrize(("wrist", "amplitude", "verdict"), [(6, 0.06, None), (7, 0.06, None), (7, 0.04, "still")])
def test_one_moving_wrist_is_motion(wrist, amplitude, verdict):
    """A sine of amplitude a has variance a^2 / 2: 0.0018 and 0.0008 around the threshold of 0.0014."""
    positions = np.tile(SKELETON.mean_pose, (200, 1, 1))
    positions[:, wrist, 1] += amplitude * np.sin(np.linspace(0, 10 * np.pi, 200))
    positions[:, SKELETON.joint("nose")] += np.linspace(0, 1, 200)[:, None]  # the head alone makes no gesture
    assert selection.still(positions, SKELETON, VideoSettings().min_motion) == verdict


def test_hands_are_wrists_and_fingers():
    assert selection.hand_joints(SKELETON) == list(range(6, 38))


def test_settings_survive_a_file(tmp_path):
    settings = from_pairs(["min_seconds=3", "recognise=tiny.en", "filters.min_words=none", "filters.stride = 5"])
    assert settings.min_seconds == 3.0 and settings.recognise == "tiny.en"
    assert settings.filters == VideoSettings().filters._replace(min_words=None, stride=5)
    path = tmp_path / "settings.json"
    path.write_text(json.dumps(settings.as_json()))
    assert read_settings(path) == settings
    assert from_pairs(["min_seconds=5", "recognise=none", "filters.min_words=2", "filters.stride=10"], settings) == (
        VideoSettings()
    )


@pytest.mark.parametrize(
    ("pair", "message"),
    [
        ("min_second=3", "unknown setting 'min_second'"),
        ("filters.words=3", "unknown setting 'filters.words'"),
        ("filters=3", "setting filters is a group"),
        ("min_seconds", "has no value"),
        ("min_seconds=long", "expected a number"),
        ("min_seconds=nan", "expected a number"),
        ("min_seconds=none", "expected a number"),
        ("num_reference_frames=2.5", "expected a whole number"),
        ("min_visible=50", "expected 0 to 1"),
        ("filters.stride=0", "at least 1"),
        ("filters.min_words=two", "expected a whole number or none"),
    ],
)
def test_a_wrong_pair_says_what_was_expected(pair, message):
    with pytest.raises(UserError, match=message):
        from_pairs([pair])


@pytest.mark.parametrize(
    "text", ["", "[1]", '{"min_seconds": "3"}', '{"fps": true}', '{"filters": {"min_words": 2.5}}', '{"x": 1}']
)
def test_a_wrong_file_is_named(tmp_path, text):
    path = tmp_path / "settings.json"
    path.write_text(text)
    with pytest.raises(UserError, match=r"settings\.json"):
        read_settings(path)


def test_every_setting_is_documented():
    for field in dataclasses.fields(VideoSettings):
        assert f"    {field.name}: " in (inspect.getdoc(VideoSettings) or "")
