"""Settings that cannot be used are refused before a run starts, and changes without effect are accepted."""

import pytest

from ha2g_jax.checkpoint import model_folder
from ha2g_jax.checkpoint.assets import Assets
from ha2g_jax.config import checks, presets
from ha2g_jax.config import settings as configs
from ha2g_jax.errors import UserError
from ha2g_jax.features.text import Vocabulary
from ha2g_jax.methods.build import build
from ha2g_jax.skeleton import load_skeleton


@pytest.fixture
def config():
    return configs.debug(configs.paper("ted_gesture"))


@pytest.fixture
def workdir(config, tmp_path):
    """The workdir of a run of `config`."""
    skeleton = load_skeleton("ted_gesture")
    starts = skeleton.mean_directions[None, None].repeat(4, axis=1)
    model_folder.write_description(tmp_path, config, Assets(skeleton, Vocabulary(("one",)), {}, starts))
    return tmp_path


@pytest.mark.parametrize(("name", "value"), [("path", "elsewhere"), ("workers", 3), ("cache_gib", 1.0)])
def test_a_run_may_move_to_another_machine(workdir, config, name, value):
    config.data[name] = value
    config.train.devices = 4
    checks.check_workdir(workdir, config)


def test_differing_settings_are_named(workdir, config):
    config.seed, config.loss.ha2g.weights.gan = 1, 0.5
    found = r"loss\.ha2g\.weights\.gan \(1\.0 there, 0\.5 here\), seed \(0 there, 1 here\)"
    with pytest.raises(UserError, match=found):
        checks.check_workdir(workdir, config)


def test_the_end_of_a_cosine_is_no_free_setting(workdir, config):
    config.train.steps = 9
    checks.check_workdir(workdir, config)
    config.train.schedule = "cosine"
    with pytest.raises(UserError, match=r"train\.schedule .*, train\.steps"):
        checks.check_workdir(workdir, config)


def test_a_workdir_from_before_a_setting_existed_goes_on(workdir, config):
    path = workdir / model_folder.CONFIG
    path.write_text("\n".join(line for line in path.read_text().splitlines() if '"mirror"' not in line))
    checks.check_workdir(workdir, config)
    path.write_text("{")
    with pytest.raises(UserError, match=r"config\.json is damaged"):
        checks.check_workdir(workdir, config)


def test_a_workdir_must_be_a_folder(tmp_path, config):
    (tmp_path / "file").write_text("")
    for path in (tmp_path / "file", tmp_path / "file" / "run"):
        with pytest.raises(UserError, match="is not a folder"):
            checks.check_workdir(path, config)


@pytest.mark.parametrize(
    ("section", "name", "value"),
    [
        ("train", "steps", 0),
        ("train", "sample_every", -1),
        ("train", "devices", 99),
        ("train", "warmup_epochs", -1),
        ("train", "learning_rate", -1e-3),
        ("train", "discriminator_learning_rate", float("nan")),
        ("data", "workers", -1),
        ("data", "mirror", 2.0),
        ("data", "lookahead", 1.5),
    ],
)
def test_settings_that_cannot_be_used_are_named(config, section, name, value):
    checks.check_settings(config)
    config[section][name] = value
    with pytest.raises(UserError, match=name):
        checks.check_settings(config)


@pytest.mark.parametrize(("name", "value"), [("huber_delta", 0.0), ("temperature", 0.0), ("weights.huber", -1.0)])
def test_settings_of_the_loss_that_cannot_be_used_are_named(config, name, value):
    """A temperature of 0 would make the loss not finite after minutes of compilation."""
    config.update_from_flattened_dict({f"loss.{config.method}.{name}": value})
    with pytest.raises(UserError, match=rf"config\.loss\.ha2g\.{name} is {value}, expected"):
        checks.check_settings(config)


@pytest.mark.parametrize(
    ("method", "found"), [("ha2g", ""), ("trimodal", "takes audio, words"), ("seq2seq", "plain_w")]
)
def test_ends_are_hidden_only_where_a_model_reads_what_can_be_hidden(method, found):
    config = presets.make("talk", "debug", method, {"data.lookahead": 0.5})
    spec = build(config, load_skeleton(config.skeleton), 2, 2)
    if not found:
        checks.check_augmentation(config, spec)
        return
    with pytest.raises(UserError, match=rf"{found}.*data\.lookahead=0"):
        checks.check_augmentation(config, spec)
