"""model.json holds the random choices of `generate`, so that a page makes the same motion for a seed."""

import json

import numpy as np
import pytest

from ha2g_jax.checkpoint import model_folder
from ha2g_jax.checkpoint.onnx.export import export
from ha2g_jax.synthesis import Style, load_onnx
from ha2g_jax.synthesis.onnx_model import page_description


@pytest.fixture(scope="module")
def path(debug_model, tmp_path_factory):
    folder = tmp_path_factory.mktemp("models") / "debug"
    model_folder.save(folder, debug_model.config, debug_model.assets, debug_model.variables)
    return export(folder, folder.with_suffix(".onnx"))


def test_choices_are_those_of_generate(path, monkeypatch):
    model = load_onnx(path)
    takes = json.loads(json.dumps(page_description(path, seeds=8)))["takes"]
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


def test_the_metadata_is_included(path):
    found = page_description(path, seeds=1)
    assert found["format"] == "ha2g-jax 1"
    assert found["skeleton"]["name"] == "ted_expressive"
    assert set(found["speakers"]) == {"ada", "ben"}
