"""What is shown of the inside of a model is what the model computes when it generates."""

import inspection
import numpy as np
import pytest

from ha2g_jax import synthesis
from ha2g_jax.features.text import Word

WORDS = (Word("one", 0.3, 0.6), Word("two", 1.2, 1.5), Word("three", 2.6, 2.9))


@pytest.fixture(scope="module")
def speech():
    return np.random.default_rng(1).normal(0, 0.1, 4 * 16000).astype(np.float32)


@pytest.mark.parametrize("kind", ["debug_model", "sampling_model"])
def test_last_stage_is_the_generated_window(kind, speech, request):
    model = request.getfixturevalue(kind)
    spec, style = model.spec, model.assets.speakers["ada"]
    seed_pose = model.assets.seed_poses[0]
    windows = model.sample_windows(speech, (), style, seed_pose, 3)
    first = spec.window_stride
    for window, start in enumerate([seed_pose, windows[0, first : first + spec.num_seed_frames]]):
        stages = inspection.stage_poses(model, speech, style, start, window=window, seed=3)
        assert stages.shape == (6, spec.num_frames, 42, 3)
        np.testing.assert_allclose(stages[-1], windows[window], atol=1e-5)


def test_a_stage_has_the_mean_pose_where_it_has_no_bones(debug_model, speech):
    skeleton = debug_model.assets.skeleton
    stages = inspection.stage_poses(
        debug_model, speech, debug_model.assets.speakers["ada"], debug_model.assets.seed_poses[0]
    )
    mean = skeleton.mean_directions / np.linalg.norm(skeleton.mean_directions, axis=-1, keepdims=True)
    for level, poses in zip(skeleton.levels, stages, strict=True):
        is_mean = np.isclose(poses, mean[None], atol=1e-5).all(axis=(0, 2))
        assert set(np.flatnonzero(is_mean)) == set(range(skeleton.num_bones)) - set(level)


def test_columns_of_the_blend_sum_to_one_and_differ_between_speakers(debug_model):
    blend = inspection.audio_blend(debug_model, np.stack(list(debug_model.assets.speakers.values())))
    assert blend.shape == (2, 3, 6)
    np.testing.assert_allclose(blend.sum(axis=1), 1, atol=1e-6)
    assert np.abs(blend[0] - blend[1]).max() > 1e-3


def test_words_are_seen_where_they_are_spoken(debug_model):
    silence, spoken = (inspection.text_features(debug_model, words, 60) for words in ((), (Word("two", 2.0, 2.3),)))
    differs = np.flatnonzero(np.abs(spoken - silence).max(axis=1) > 1e-6)
    assert 30 in differs
    assert np.ptp(differs) <= 16  # D4: the receptive field


def test_similarities_are_cosines_of_words_and_their_sounds(debug_model, speech):
    found = inspection.word_similarities(debug_model, speech, WORDS)
    high = synthesis.encode_features(debug_model, speech).high[[4, 18, 39]]
    text = inspection.text_features(debug_model, WORDS, 60)[[4, 18, 39]]
    lengths = np.linalg.norm(text, axis=1)[:, None] * np.linalg.norm(high, axis=1)[None]
    np.testing.assert_allclose(found["high"], text @ high.T / lengths, atol=1e-5)
    assert all(np.abs(level).max() <= 1 + 1e-5 for level in found.values())
