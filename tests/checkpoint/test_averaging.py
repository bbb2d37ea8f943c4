"""The average of models is a model, and models that do not fit together are refused."""

import dataclasses

import jax
import numpy as np
import pytest

from ha2g_jax import cli
from ha2g_jax.checkpoint import loading, model_folder
from ha2g_jax.checkpoint.averaging import average_models
from ha2g_jax.errors import UserError
from ha2g_jax.features.text import Vocabulary


@pytest.fixture
def save(debug_model, tmp_path):
    """A function that saves the debug model with weights and styles times a factor."""

    def save(name, factor=1.0, config=debug_model.config, **changes):
        assets = debug_model.assets
        speakers = {speaker: factor * style for speaker, style in assets.speakers.items()}
        assets = dataclasses.replace(assets, speakers=speakers, **changes)
        variables = jax.tree.map(lambda leaf: factor * np.asarray(leaf), debug_model.variables)
        return model_folder.save(tmp_path / name, config, assets, variables)

    return save


def test_weights_and_styles_are_the_mean(debug_model, save, tmp_path, capsys):
    models = [save("a", 1.0), save("b", 2.0), save("c", 4.5)]
    assert cli.main(["average", *map(str, models), "-o", str(tmp_path / "mean")]) == 0
    assert capsys.readouterr().out.strip() == str(tmp_path / "mean")
    mean = loading.load(tmp_path / "mean")
    expected = jax.tree.map(lambda leaf: 2.5 * np.asarray(leaf), debug_model.variables)
    jax.tree.map(lambda *leaves: np.testing.assert_allclose(*leaves, rtol=1e-6), mean.variables, expected)
    for speaker, style in debug_model.assets.speakers.items():
        np.testing.assert_allclose(mean.assets.speakers[speaker], 2.5 * style, rtol=1e-6)
    assert mean.assets.hash not in {loading.load(model).assets.hash for model in models}


def test_models_of_other_training_are_refused(debug_model, save, tmp_path):
    first = save("first")
    skeleton = debug_model.assets.skeleton
    other = debug_model.config.copy_and_resolve_references()
    other.model.inferer.dropout = 0.5
    cases = {
        "words": {"vocabulary": Vocabulary(tuple(reversed(debug_model.assets.vocabulary.words)))},
        "been trained on different motion": {
            "skeleton": dataclasses.replace(skeleton, mean_directions=skeleton.mean_directions + 0.01)
        },
        "different settings of the model": {"config": other},
    }
    for number, (difference, changes) in enumerate(cases.items()):
        second = save(f"second-{number}", **changes)
        with pytest.raises(UserError, match=f"^[^\n]*{difference}; average models of one config and one corpus$"):
            average_models([first, second], tmp_path / "mean")
    with pytest.raises(UserError, match="give two or more"):
        average_models([first], tmp_path / "mean")
    assert not (tmp_path / "mean").exists()
