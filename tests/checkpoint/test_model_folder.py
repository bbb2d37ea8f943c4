"""A model folder restores the model, and a damaged one is reported in one line."""

import json
import shutil
import tracemalloc

import jax
import numpy as np
import pytest
import safetensors.numpy

from ha2g_jax.checkpoint import assets as assets_module
from ha2g_jax.checkpoint import model_folder, weights
from ha2g_jax.errors import UserError


@pytest.fixture
def folder(debug_folder, tmp_path):
    """A copy that a test may damage."""
    return shutil.copytree(debug_folder, tmp_path / "model")


def test_the_model_comes_back(debug_model, debug_folder):
    loaded = model_folder.load(debug_folder)
    settings = json.loads(debug_model.config.to_json())
    del settings["train"], settings["loss"]
    assert json.loads((debug_folder / "config.json").read_text()).keys() == settings.keys()
    assert json.loads(loaded.config.to_json()) == settings
    assert jax.tree.structure(loaded.variables) == jax.tree.structure(debug_model.variables)
    jax.tree.map(np.testing.assert_array_equal, loaded.variables, debug_model.variables)
    assert assets_module.to_json(loaded.assets) == assets_module.to_json(debug_model.assets) | {
        "hash": loaded.assets.hash
    }
    np.testing.assert_array_equal(loaded.assets.seed_poses, debug_model.assets.seed_poses)
    assert len(loaded.assets.hash) == 16 and loaded.assets.hash != debug_model.assets.hash


def test_a_large_model_is_stored_in_half_precision_but_for_values_beyond_it(tmp_path, monkeypatch):
    monkeypatch.setattr(weights, "_HALF_PRECISION_ABOVE", 0)
    variables = {"batch_stats": {"variance": np.array([7e4, 1])}, "params": {"kernel": np.array([0.1, 2])}}
    weights.write(tmp_path / "half.safetensors", variables)
    found = safetensors.numpy.load_file(tmp_path / "half.safetensors")
    assert found["batch_stats/variance"].dtype == np.float32 and found["batch_stats/variance"][0] == 7e4
    assert found["params/kernel"].dtype == np.float16
    np.testing.assert_allclose(found["params/kernel"], [0.1, 2], rtol=1e-3)


def test_weights_are_written_without_a_copy_and_have_the_hash_of_their_file(tmp_path):
    variables = {"params": {name: np.full((1 << 20, 4), 0.5, np.float32) for name in "ab"}, "batch_stats": {}}
    tracemalloc.start()
    found = weights.write(tmp_path / "model.safetensors", variables, is_exact=True)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 1 << 26  # older releases of safetensors copy the numbers once
    assert found == weights.hash_of_file(tmp_path / "model.safetensors") != weights.hash_of(variables)
    weights.write(tmp_path / "half.safetensors", variables)
    assert weights.hash_of(variables) == weights.hash_of_file(tmp_path / "half.safetensors")


def test_nothing_is_overwritten(debug_model, folder):
    with pytest.raises(UserError, match="exists already"):
        model_folder.save(folder, debug_model.config, debug_model.assets, debug_model.variables)
    assert sorted(path.name for path in folder.parent.iterdir()) == ["model"]


def test_weights_that_are_not_finite_are_not_written(debug_model, tmp_path):
    variables = jax.tree.map(lambda leaf: np.full_like(leaf, np.nan), debug_model.variables)
    with pytest.raises(UserError, match="of the weights has values that are not finite"):
        model_folder.save(tmp_path / "model", debug_model.config, debug_model.assets, variables)
    assert not (tmp_path / "model").exists()


def _truncate(folder):
    weights = folder / "model.safetensors"
    weights.write_bytes(weights.read_bytes()[:-100])


def _other_weights(folder):
    weights = folder / "model.safetensors"
    data = bytearray(weights.read_bytes())
    data[-1] ^= 1
    weights.write_bytes(data)


def _edit(name, change):
    def edit(folder):
        values = json.loads((folder / name).read_text())
        change(values)
        (folder / name).write_text(json.dumps(values))

    return edit


def _assets(**changes):
    return _edit("assets.json", lambda assets: assets.update(changes))


DAMAGE = {
    "truncated weights": (_truncate, "model.safetensors is damaged"),
    "one bit of the weights": (_other_weights, "model.safetensors has hash"),
    "another shape": (
        _edit("config.json", lambda config: config["model"]["inferer"].update(hidden_dim=9)),
        "has shape .* instead of",
    ),
    "no config": (lambda folder: (folder / "config.json").unlink(), "config.json is missing"),
    "assets are no JSON": (lambda folder: (folder / "assets.json").write_text("[]"), "assets.json is damaged"),
    "unknown skeleton": (_edit("assets.json", lambda assets: assets["skeleton"].update(name="dog")), "'dog'"),
    "later version": (_assets(schema_version=9), "schema version 9"),
    "many seed poses": (_assets(seed_poses=[[[[0.0] * 3] * 42] * 4] * 1200), "1200 seed poses instead of at most"),
    "a style that is not finite": (_assets(speakers={"ada": [float("nan")] * 18}), "not finite"),
}


@pytest.mark.parametrize(("damage", "message"), DAMAGE.values(), ids=DAMAGE)
def test_damage_is_named(folder, damage, message):
    damage(folder)
    with pytest.raises(UserError, match=message) as error:
        model_folder.load(folder)
    assert "\n" not in str(error.value)


def test_no_model(tmp_path):
    for path in (tmp_path / "nowhere", tmp_path):
        with pytest.raises(UserError, match=r"no model in .*expected 'demo', a workdir"):
            model_folder.load(path)


def test_what_is_no_checkpoint_in_a_workdir_is_named(tmp_path):
    (tmp_path / "best").mkdir()
    for name in ("config.json", "model.onnx"):
        (tmp_path / name).write_text("{}")
    for name, message in {"typo": "nothing is there", "model.onnx": "is for ha2g generate alone"}.items():
        with pytest.raises(UserError, match=message):
            model_folder.load(tmp_path / name)
