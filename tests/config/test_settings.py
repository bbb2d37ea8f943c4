"""The table of settings: every default is possible, and what is missing, unknown or not possible is named."""

import ml_collections
import pytest

from ha2g_jax.checkpoint.model_folder import config_to_json
from ha2g_jax.config import presets, settings
from ha2g_jax.errors import UserError
from ha2g_jax.limits import MAX_SETTING


@pytest.fixture
def config():
    return presets.sized("ted_gesture", "debug")


@pytest.mark.parametrize("method", settings.OF_METHOD)
def test_the_settings_of_a_method_are_possible_and_all_that_its_config_has(method):
    config = settings.paper("ted_gesture", method)
    config.train.best_by = "loss/total"
    settings.check(config)
    names = [row.name for row in settings.table(method)]
    assert len(set(names)) == len(names)
    flat: dict = ml_collections.ConfigDict(config).to_dict()

    def leaves(part, prefix=""):
        for name, value in part.items():
            yield from leaves(value, f"{prefix}{name}.") if isinstance(value, dict) else [prefix + name]

    assert sorted(leaves(flat)) == sorted(names)
    assert all(row.meaning and row.name in settings.as_text(method) for row in settings.table(method))


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("train.steps", MAX_SETTING + 1, "a whole number from 1"),
        ("train.ema", 1.0, "a number from 0 to below 1"),
        ("train.accumulate", 3, "a divisor of config.train.batch_size, 4"),
        ("train.best_by", "loss/mse", "one of loss/angle, loss/contrastive"),
        ("data.noise_snr_db", (20.0, 10.0), "a lower and an upper bound"),
        ("data.num_seed_frames", 18, "a whole number from 1 to 17"),
        ("model.audio.resnet_se.channels", (8, 8, 18, 32), "the third a multiple of 4"),
        ("model.audio.whisper.heads", 5, "an even multiple of the heads"),
        ("model.audio.levels", ("low", "low"), "one or more of low, mid, high, each once"),
        ("model.audio.levels", (["low"],), "one or more of low, mid, high, each once"),
    ],
)
def test_a_value_that_is_not_possible_is_named_with_what_is(config, name, value, expected):
    settings.check(config)
    config.update_from_flattened_dict({name: value})
    with pytest.raises(UserError, match=rf"config\.[\w.]+ is .*, expected .*{expected}.*: set --config\."):
        settings.check(config)


def test_a_setting_that_is_missing_or_unknown_is_named(config):
    del config.loss.ha2g.weights["kld"]
    with pytest.raises(UserError, match=r"config\.loss\.ha2g\.weights\.kld is missing"):
        settings.check(config)
    config.loss.ha2g.weights.kld, config.loss.ha2g.weights.smoothness = 0.1, 1.0
    with pytest.raises(UserError, match=r"unknown setting config\.loss\.ha2g\.weights\.smoothness;"):
        settings.check(config)
    del config.loss.ha2g.weights["smoothness"]
    config.train.stepz = 5  # in a config file
    with pytest.raises(UserError, match=r"unknown setting config\.train\.stepz;"):
        settings.check(config)
    del config["loss"]
    settings.check(config, is_trained=False)
    with pytest.raises(UserError, match=r"config\.loss\.ha2g\.weights\.gan is missing"):
        settings.check(config)


@pytest.mark.parametrize("method", presets.METHODS)
def test_a_stored_config_is_the_config(method):
    config = presets.make("talk", "debug", method)
    assert settings.from_json(config_to_json(config)).to_json() == config.to_json()


def test_a_stored_config_has_the_defaults_of_what_it_lacks():
    stored = config_to_json(presets.make("talk", "debug"))
    del stored["train"], stored["loss"], stored["data"]["mirror"]
    config = settings.from_json(stored | {"model": stored["model"] | {"older": 1}})
    assert config.data.mirror == 0.0 and "train" not in config and "loss" not in config
    settings.check(config, is_trained=False)


@pytest.mark.parametrize("values", [[], {"skeleton": "ted_gesture", "data": 3}])
def test_other_values_are_no_config(values):
    with pytest.raises(ValueError):
        settings.from_json(values)


def test_a_change_that_does_not_fit_is_named(config):
    with pytest.raises(UserError, match=r"no setting 'model\.audoi\.kind'"):
        settings.change(config, {"model.audoi.kind": "x"})
    with pytest.raises(UserError, match=r"train\.steps cannot be 'abc'; expected a value like"):
        settings.change(config, {"train.steps": "abc"})
