"""Styles to generate motion in, and the random choices that a page in a browser repeats."""

import json
import types
from typing import Any, cast

import numpy as np
import pytest

from ha2g_jax.checkpoint.assets import Assets
from ha2g_jax.errors import UserError
from ha2g_jax.features.text import Vocabulary
from ha2g_jax.limits import MAX_SEED
from ha2g_jax.skeleton import load_skeleton
from ha2g_jax.synthesis import load_onnx
from ha2g_jax.synthesis.onnx_model import page_description
from ha2g_jax.synthesis.style import VARIATION, Style, choose_style, later_seed

DIM = 3
SPEC: Any = types.SimpleNamespace(style_dim=DIM, method="ha2g")


def draw(speakers, count=1, **fields):
    skeleton = load_skeleton("ted_expressive")
    assets = Assets(skeleton, Vocabulary(()), speakers, skeleton.mean_directions[None, None])
    drawn = [choose_style(SPEC, {}, assets, Style(**fields), seed) for seed in range(count)]
    assert all(described["kind"] == "random" for _, described in drawn)
    return np.array([values for values, _ in drawn])


def test_mean_and_covariance_are_those_of_the_speakers():
    rng = np.random.default_rng(0)
    styles = rng.standard_normal((20, DIM)) * [1, 0.1, 2] + [3, 0, -1]
    drawn = draw({f"speaker-{number}": style for number, style in enumerate(styles)}, 4000)
    assert drawn.dtype == np.float32
    np.testing.assert_allclose(drawn.mean(0), styles.mean(0), atol=0.1)
    np.testing.assert_allclose(np.cov(drawn.T), np.cov(styles.T), atol=0.3)


def test_styles_of_two_speakers_lie_on_their_line():
    first, second = np.array([0.0, 1, 2]), np.array([1.0, 1, 4])
    drawn = draw({"a": first, "b": second}, 5) - first
    np.testing.assert_allclose(np.cross(drawn, second - first), 0, atol=1e-6)


def test_one_speaker_is_varied_and_without_any_the_prior_is_drawn():
    one = draw({"a": np.array([5.0, 6, 7])}, 1000)
    np.testing.assert_allclose(one.std(0), VARIATION, rtol=0.1)
    np.testing.assert_allclose(one.mean(0), [5, 6, 7], atol=0.05)
    prior = draw({}, 1000)
    np.testing.assert_allclose(prior.std(0), 1, rtol=0.1)
    np.testing.assert_allclose(prior.mean(0), 0, atol=0.1)


def test_choices_are_those_of_generate(debug_onnx, monkeypatch):
    model = load_onnx(debug_onnx)
    takes = json.loads(json.dumps(page_description(debug_onnx, seeds=8)))["takes"]
    assert len({take["seed_pose"] for take in takes}) > 1
    starts = []
    sample = type(model).sample_windows
    monkeypatch.setattr(
        type(model), "sample_windows", lambda self, *inputs: starts.append(inputs[3]) or sample(self, *inputs)
    )
    for seed, take in enumerate(takes):
        style, _ = model.choose_style(Style(), seed)
        varied, _ = model.choose_style(Style(speaker="ada", variation=0.5), seed)
        np.testing.assert_array_equal(style, np.float32(take["style"]))
        exact = np.float32(model.assets.speakers["ada"])
        np.testing.assert_array_equal(varied, exact + np.float32(0.5) * np.float32(take["variation"]))
        model.generate(np.zeros(4800, np.float32), seed=seed)
        np.testing.assert_array_equal(starts[-1], model.assets.seed_poses[take["seed_pose"]])


def test_seeds_go_on_after_the_largest_from_0():
    assert [later_seed(MAX_SEED - 1, count) for count in range(3)] == [MAX_SEED - 1, MAX_SEED, 0]
    assert later_seed(cast(Any, np.int32(3)), 1) == later_seed(cast(Any, np.array(3)), 1) == 4
    for seed in (-1, MAX_SEED + 1, 0.0, True, "0"):
        with pytest.raises(UserError, match="seed"):
            later_seed(cast(Any, seed), 0)
