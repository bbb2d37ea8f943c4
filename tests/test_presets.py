"""Every row of the paper's tables is a config, and differs from the full model where the paper says."""

import jax
import pytest

from ha2g_jax.config import presets
from ha2g_jax.config.presets import ablations
from ha2g_jax.errors import UserError
from ha2g_jax.methods import TRAINABLE
from ha2g_jax.methods import build as specs
from ha2g_jax.skeleton import load_skeleton


def build(config):
    return specs.build(config, load_skeleton(config.skeleton), vocabulary_size=10, num_speakers=3)


@pytest.mark.parametrize("table", ablations.TABLES)
def test_every_row_of_a_table_builds_and_is_another_config(table):
    data = "ted_gesture" if table == "gesture_ablation" else "talk"
    configs = [presets.make(data, "debug", changes=changes) for changes in ablations.TABLES[table].values()]
    assert all(build(config) for config in configs)
    assert len({config.to_json() for config in configs}) == len(configs)


def test_stages_that_an_ablation_leaves_out_are_gone():
    widths = {
        name: [
            len(channels) for channels in build(presets.make("talk", "debug", changes=changes)).generator.level_channels
        ]
        for name, changes in ablations.POSE_INFERER.items()
    }
    assert widths["Holistic"] == [126]
    assert widths["without hand hierarchy"] == [24, 30, 36, 126]
    assert widths["without body hierarchy"] == [36, 66, 96, 126]
    assert widths["HA2G Full"] == [24, 30, 36, 66, 96, 126]


def test_a_method_weighs_its_own_terms():
    for method in presets.METHODS:
        config = presets.make("ted_expressive", method=method)
        assert set(config.loss[config.method].weights) == set(TRAINABLE[config.method].term_names)


def test_the_release_weighs_a_level_as_the_public_code():
    for data, huber in (("ted_expressive", 250.0), ("ted_gesture", 70.0)):
        config = presets.make(data, method="ha2g_release")
        assert (config.loss.ha2g.weights.huber, config.loss.ha2g.weights.gan) == (huber, 5.0)
        assert config.train.discriminator_learning_rate == pytest.approx(0.2 * config.train.learning_rate)


def test_the_study_takes_the_settings_that_its_trials_chose_and_a_change_overrides_them():
    assert presets.make("talk", "study").loss.ha2g.weights.style == 0.01
    assert presets.make("talk", "study", "seq2seq").train.learning_rate == 1e-3
    assert presets.make("talk", "small").loss.ha2g.weights.style == 0.05
    changed = presets.make("talk", "study", changes={"loss.ha2g.weights.style": 0.2})
    assert changed.loss.ha2g.weights.style == 0.2


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"data": "dance"}, "no data 'dance'; expected one of talk"),
        ({"data": "talk", "method": "gpt"}, "no method 'gpt'; expected one of ha2g"),
        ({"data": "talk", "size": "huge"}, "no size 'huge'"),
        ({"data": "talk", "changes": {"model.audio.depth": 3}}, "no setting 'model.audio.depth'"),
    ],
)
def test_an_unknown_name_is_named(arguments, message):
    with pytest.raises(UserError, match=message):
        presets.make(**arguments)


@pytest.mark.parametrize("levels", [(1, 2), (2, 1, 6), (0, 6), (6, 6)])
def test_levels_that_do_not_end_in_the_whole_pose_are_refused(levels):
    config = presets.make("talk", "debug", changes={"model.inferer.levels": levels})
    with pytest.raises(UserError, match=r"config.model.inferer.levels"):
        build(config)


def test_a_config_from_json_has_the_terms_of_its_method():
    from ha2g_jax.checkpoint.model_folder import config_to_json
    from ha2g_jax.config import settings as configs

    config = presets.make("talk", "debug", "trimodal")
    again = configs.from_json(config_to_json(config))
    assert set(again.loss.trimodal.weights) == {"gan", "huber", "style", "kld"}
    assert jax.tree.structure(dict(again.model)) == jax.tree.structure(dict(config.model))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"model.audoi.kind": "x"}, "no setting 'model.audoi.kind'"),
        ({"model.audio.kind.more": "x"}, "no setting 'model.audio.kind.more'"),
        ({"train.steps": "abc"}, "train.steps cannot be 'abc'; expected a value like"),
    ],
)
def test_a_change_that_does_not_fit_is_named(changes, message):
    with pytest.raises(UserError, match=message):
        presets.make("talk", "debug", changes=changes)
