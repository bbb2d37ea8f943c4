"""Old names of settings are read, and each is named in one line."""

import json

import ml_collections

from ha2g_jax import config as configs
from ha2g_jax import config_renames, launch, presets
from ha2g_jax.checkpoint.model_folder import config_to_json

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
        "from ha2g_jax import presets\n"
        "def get_config(size=''):\n"
        "    config = presets.make('talk', size)\n"
        "    config.model.audio.blocks = (1, 2, 1, 1)\n"
        "    return config\n"
    )
    config = launch.load_config(f"{file}:debug")
    assert config.model.audio.resnet_se.blocks == (1, 2, 1, 1)
    assert "model.audio.blocks is now model.audio.resnet_se.blocks" in capsys.readouterr().err
    assert isinstance(config, ml_collections.ConfigDict) and json.loads(config.to_json())
