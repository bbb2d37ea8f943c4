"""The average of models is a model, and models that do not fit together are refused."""

import dataclasses

import jax
import numpy as np
import pytest

from ha2g_jax import cli
from ha2g_jax.checkpoint import model_folder, weights
from ha2g_jax.checkpoint.publishing import _difference, average_models
from ha2g_jax.checkpoint.weights import is_word_table
from ha2g_jax.errors import UserError
from ha2g_jax.features.text import UNKNOWN, Vocabulary


@pytest.fixture
def save(debug_model, tmp_path):
    """A function that saves the debug model with weights and styles times a factor."""

    def save(name, factor=1.0, config=debug_model.config, **changes):
        speakers = {speaker: factor * style for speaker, style in reversed(debug_model.assets.speakers.items())}
        assets = dataclasses.replace(debug_model.assets, **({"speakers": speakers} | changes))
        variables = jax.tree.map(lambda leaf: factor * np.asarray(leaf), debug_model.variables)
        return model_folder.save(tmp_path / name, config, assets, variables)

    return save


def test_weights_and_styles_are_the_mean(debug_model, save, tmp_path, capsys):
    models = [save("a", 1.0), save("b", 2.0), save("c", 4.5)]
    assert cli.main(["average", *map(str, models), "-o", str(tmp_path / "mean")]) == 0
    assert capsys.readouterr().out.strip() == str(tmp_path / "mean")
    mean = model_folder.load(tmp_path / "mean")
    expected = jax.tree.map(lambda leaf: 2.5 * np.asarray(leaf), debug_model.variables)
    jax.tree.map(lambda *leaves: np.testing.assert_allclose(*leaves, rtol=1e-6), mean.variables, expected)
    assert list(mean.assets.speakers) == list(model_folder.load(models[0]).assets.speakers)
    for speaker, style in debug_model.assets.speakers.items():
        np.testing.assert_allclose(mean.assets.speakers[speaker], 2.5 * style, rtol=1e-6)
    assert mean.assets.hash not in {model_folder.load(model).assets.hash for model in models}


def test_words_meet_by_name(debug_model, save, tmp_path):
    words = debug_model.assets.vocabulary.words
    other = Vocabulary((*reversed(words[1:]), "new"))
    average_models([save("a"), save("b", vocabulary=other)], tmp_path / "mean")
    (name,) = filter(is_word_table, weights.flatten(debug_model.variables))
    table = np.asarray(weights.flatten(debug_model.variables)[name])
    mean = weights.flatten(model_folder.load(tmp_path / "mean").variables)[name]
    index = debug_model.assets.vocabulary.encode
    np.testing.assert_allclose(mean[index(words[-1])], (table[index(words[-1])] + table[2]) / 2, rtol=1e-6)
    np.testing.assert_allclose(mean[index(words[0])], (table[index(words[0])] + table[UNKNOWN]) / 2, rtol=1e-6)


def test_models_of_other_training_are_refused(debug_model, save, tmp_path):
    first = save("first")
    skeleton = debug_model.assets.skeleton
    other = debug_model.config.copy_and_resolve_references()
    other.model.inferer.dropout = 0.5
    cases = {
        "the mean pose of their data": {
            "skeleton": dataclasses.replace(skeleton, mean_directions=skeleton.mean_directions + 0.2)
        },
        r"model\.inferer\.dropout, 0\.0 and 0\.5": {"config": other},
    }
    for number, (difference, changes) in enumerate(cases.items()):
        second = save(f"second-{number}", **changes)
        with pytest.raises(UserError, match=f"^[^\n]* differ in {difference}; average models that were trained"):
            average_models([first, second], tmp_path / "mean")
    assert not (tmp_path / "mean").exists()


def test_tables_of_speakers_in_another_order_are_refused(save):
    first = model_folder.load(save("a"))
    first = first._replace(spec=first.spec._replace(identity="speaker"))
    speakers = dict(reversed(first.assets.speakers.items()))
    second = first._replace(assets=dataclasses.replace(first.assets, speakers=speakers))
    assert _difference(first, second) == "the order of their speakers" and not _difference(first, first)
