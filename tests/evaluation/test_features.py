"""Latents come from the auto-encoder in evaluation mode, whatever the batch, and are named by its weights."""

import hashlib

import jax
import numpy as np
import pytest

from ha2g_jax.checkpoint import model_folder
from ha2g_jax.checkpoint.assets import Assets
from ha2g_jax.config import presets
from ha2g_jax.evaluation.features import PoseFeatures
from ha2g_jax.features.text import Vocabulary
from ha2g_jax.methods import build, variable_shapes
from ha2g_jax.methods.method import subtract_mean
from ha2g_jax.skeleton import load_skeleton


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """An auto-encoder of TED-Gesture with random weights."""
    config = presets.parse("ted_gesture:debug", "autoencoder")
    skeleton = load_skeleton("ted_gesture")
    shapes = variable_shapes(build(config, skeleton, 0, 0))
    random = np.random.default_rng(0)
    variables = {
        "params": jax.tree.map(lambda x: random.normal(0, 0.1, x.shape).astype(np.float32), shapes["params"]),
        "batch_stats": jax.tree.map(
            lambda x: random.uniform(0.5, 1, x.shape).astype(np.float32), shapes["batch_stats"]
        ),
    }
    assets = Assets(skeleton, Vocabulary(()), {}, np.ones((1, 4, skeleton.num_bones, 3), np.float32))
    return model_folder.save(tmp_path_factory.mktemp("autoencoder") / "model", config, assets, variables)


@pytest.fixture(scope="module")
def windows(perform):
    return np.stack([clip.directions[start : start + 34] for clip in perform(3) for start in (0, 40, 80)])


def test_latents_are_those_of_the_module(folder, windows):
    features = PoseFeatures(folder)
    latents = features(windows)
    assert latents.shape == (9, features.latent_dim) and latents.dtype == np.float64
    loaded = model_folder.load(folder)
    poses = subtract_mean(loaded.spec, windows)
    expected = loaded.spec.generator.apply(loaded.variables, poses, train=False, method="encode")
    np.testing.assert_allclose(latents, expected, atol=1e-5)
    restored = loaded.spec.generator.apply(loaded.variables, poses, train=False)
    assert features.reconstruction_error(windows) == pytest.approx(float(np.abs(restored - poses).mean()), rel=1e-4)


def test_a_latent_does_not_depend_on_its_batch(folder, windows):
    features = PoseFeatures(folder)
    many = features(np.concatenate([windows] * 30))  # 270, more than one batch
    for start in range(0, 270, 9):
        np.testing.assert_allclose(many[start : start + 9], many[:9], atol=1e-6)  # not to the bit on all processors
    np.testing.assert_allclose(features(windows[4:5])[0], many[4], atol=1e-6)
    assert features(windows[:0]).shape == (0, features.latent_dim)


def test_the_id_is_the_hash_of_the_weights(folder):
    features = PoseFeatures(folder)
    assert len(features.id) == 64
    assert features.id == hashlib.sha256((folder / model_folder.WEIGHTS).read_bytes()).hexdigest()
    assert features.id.startswith(model_folder.load(folder).assets.hash)
    assert (features.skeleton.name, features.fps) == ("ted_gesture", 15)
