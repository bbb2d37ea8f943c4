"""Old names of settings are read, and each is named in one line."""

import json

import ml_collections
import pytest

from ha2g_jax import launch
from ha2g_jax.checkpoint.model_folder import config_to_json
from ha2g_jax.config import presets
from ha2g_jax.config import renames as config_renames
from ha2g_jax.config import settings as configs
from ha2g_jax.errors import UserError
from ha2g_jax.skeleton import load_skeleton
from ha2g_jax.train.objective import build_objective

# A config as the version before stored it, less what has kept its name.
OLD = {
    "method": "ha2g",
    "skeleton": "ted_gesture",
    "data": {"num_reference_frames": 3},
    "model": {
        "audio": {"kind": "resnet_se", "blocks": [1, 1, 1, 1], "channels": [8, 8, 16, 32], "stem_stride": [4, 1]},
        "identity": {"kind": "images", "width": 4},
    },
    "loss": {"weights": {"gan": 2.0}, "gan": "minimax", "huber_delta": 0.3, "negatives": ["high"]},
    "train": {"steps": 7},
}


def test_a_stored_config_has_its_settings_under_their_new_names():
    config = configs.from_json(OLD)
    assert config.data.num_reference_images == 3
    assert config.model.audio.resnet_se.channels == (8, 8, 16, 32) and config.model.identity.images.width == 4
    loss = config.loss.ha2g
    assert (dict(loss.weights), loss.gan, loss.huber_delta, loss.negatives) == ({"gan": 2.0}, "minimax", 0.3, ("high",))
    assert config.train.steps == 7 and "weights" not in config.loss and "width" not in config.model.identity
    assert OLD["loss"]["weights"] == {"gan": 2.0}  # left as it was


def test_an_older_model_keeps_the_seed_poses_it_was_trained_with():
    assert configs.from_json(OLD).model.inferer.seed_level == "below"
    stored = config_to_json(presets.make("talk", "debug"))
    assert configs.from_json(stored).model.inferer.seed_level == "own"


def test_a_run_of_the_older_objective_cannot_be_continued():
    stored = presets.make("talk", "debug").to_dict()
    del stored["loss"]["ha2g"]["version"], stored["loss"]["ha2g"]["style_delta"]
    config = configs.from_json(stored)
    with pytest.raises(UserError, match=r"loss\.ha2g\.version is 1, expected 2.*start a new run"):
        build_objective(config, load_skeleton(config.skeleton), 5, 3)


def test_settings_that_a_baseline_never_read_are_left_out():
    old = OLD | {"method": "trimodal"}
    values, renamed = config_renames.with_new_names(old)
    assert values["loss"] == {"trimodal": {"weights": {"gan": 2.0}, "gan": "minimax", "huber_delta": 0.3}}
    assert values["model"]["audio"] == {"kind": "waveform"}
    assert ("loss.weights", "loss.trimodal.weights") in renamed


def test_the_legacy_method_is_a_setting():
    old = {"method": "speech2gesture_legacy", "model": {"audio": {"channels": [4, 4, 8]}}}
    values, _ = config_renames.with_new_names(old)
    assert values["method"] == "speech2gesture"
    assert values["model"] == {"audio": {"kind": "spectrogram", "spectrogram": {"channels": [4, 4, 8]}}, "legacy": True}


def test_present_names_are_left_alone():
    for method in presets.METHODS:
        values = config_to_json(presets.make("talk", "debug", method))
        found, renamed = config_renames.with_new_names(values)
        assert found == values and not renamed


def test_flags_and_changes_with_old_names_are_read_and_named(capsys):
    flags = ["--config.loss.weights.gan=5.0", "--config.data.num_reference_frames=2"]
    config = launch.load_config("experiments/configs/talk.py:debug", flags)
    assert config.loss.ha2g.weights.gan == 5.0 and config.data.num_reference_images == 2
    assert capsys.readouterr().err == (
        "ha2g: the command uses old names of settings: loss.weights.gan is now loss.ha2g.weights.gan, "
        "data.num_reference_frames is now data.num_reference_images\n"
    )
    changed = presets.make("talk", "debug", changes={"loss.weights.physical": 0.0})
    assert changed.loss.ha2g.weights.physical == 0.0
    assert "loss.ha2g.weights.physical" in capsys.readouterr().err


def test_a_config_file_with_old_names_is_read_and_named(tmp_path, capsys):
    file = tmp_path / "mine.py"
    file.write_text(
        "from ha2g_jax.config import presets\n"
        "def get_config(size=''):\n"
        "    config = presets.make('talk', size)\n"
        "    config.model.audio.blocks = (1, 2, 1, 1)\n"
        "    return config\n"
    )
    config = launch.load_config(f"{file}:debug")
    assert config.model.audio.resnet_se.blocks == (1, 2, 1, 1)
    assert "model.audio.blocks is now model.audio.resnet_se.blocks" in capsys.readouterr().err
    assert isinstance(config, ml_collections.ConfigDict) and json.loads(config.to_json())
