"""What does not fit a machine, a workdir or a corpus is refused, and changes without effect are accepted."""

import pytest

from ha2g_jax.checkpoint import model_folder
from ha2g_jax.checkpoint.assets import Assets
from ha2g_jax.config import presets
from ha2g_jax.errors import UserError
from ha2g_jax.features.text import Vocabulary
from ha2g_jax.methods.build import build
from ha2g_jax.skeleton import load_skeleton
from ha2g_jax.train import fits


@pytest.fixture
def config():
    return presets.sized("ted_gesture", "debug")


@pytest.fixture
def workdir(config, tmp_path):
    """The workdir of a run of `config`."""
    skeleton = load_skeleton("ted_gesture")
    starts = skeleton.mean_directions[None, None].repeat(4, axis=1)
    model_folder.write_description(tmp_path, config, Assets(skeleton, Vocabulary(("one",)), {}, starts))
    return tmp_path


def test_a_run_may_move_to_another_machine(workdir, config):
    config.data.path, config.data.workers, config.data.cache_gib, config.train.devices = "elsewhere", 3, 1.0, 4
    fits.check_workdir(workdir, config)


def test_differing_settings_are_named(workdir, config):
    config.seed, config.loss.ha2g.weights.gan = 1, 0.5
    found = r"loss\.ha2g\.weights\.gan \(1\.0 there, 0\.5 here\), seed \(0 there, 1 here\)"
    with pytest.raises(UserError, match=found):
        fits.check_workdir(workdir, config)


def test_the_end_of_a_cosine_is_no_free_setting(workdir, config):
    config.train.steps = 9
    fits.check_workdir(workdir, config)
    config.train.schedule = "cosine"
    with pytest.raises(UserError, match=r"train\.schedule .*, train\.steps"):
        fits.check_workdir(workdir, config)


def test_a_workdir_from_before_a_setting_existed_goes_on(workdir, config):
    path = workdir / model_folder.CONFIG
    path.write_text("\n".join(line for line in path.read_text().splitlines() if '"mirror"' not in line))
    fits.check_workdir(workdir, config)


def test_more_devices_than_there_are_and_videos_of_no_motion_are_refused(config):
    fits.check_machine(config)
    config.train.devices = 99
    with pytest.raises(UserError, match="there are 8 devices, not 99"):
        fits.check_machine(config)
    with pytest.raises(UserError, match="autoencoder generates no motion to show"):
        fits.check_machine(presets.make("talk", "debug", "autoencoder", {"train.sample_every": 1}))


@pytest.mark.parametrize(
    ("method", "found"), [("ha2g", ""), ("trimodal", "takes audio, words"), ("seq2seq", "plain_w")]
)
def test_ends_are_hidden_only_where_a_model_reads_what_can_be_hidden(method, found):
    config = presets.make("talk", "debug", method, {"data.lookahead": 0.5})
    spec = build(config, load_skeleton(config.skeleton), 2, 2)
    if not found:
        fits.check_augmentation(config, spec)
        return
    with pytest.raises(UserError, match=rf"{found}.*data\.lookahead=0"):
        fits.check_augmentation(config, spec)
