"""Released files become model folders; what does not fit the table is named, and nothing is written."""

import argparse

import jax
import numpy as np
import pytest

import ha2g_jax
from ha2g_jax.checkpoint import model_folder, weights
from ha2g_jax.checkpoint.onnx import export
from ha2g_jax.checkpoint.released import table
from ha2g_jax.checkpoint.released.importing import DoesNotFitError, read_released
from ha2g_jax.cli import main
from ha2g_jax.config import presets
from ha2g_jax.errors import UserError
from ha2g_jax.evaluation.features import PoseFeatures
from ha2g_jax.features.audio import SAMPLE_RATE
from ha2g_jax.features.text import Word
from ha2g_jax.files.torch_archive import Inert
from ha2g_jax.methods import build, discriminator_shapes, variable_shapes
from ha2g_jax.skeleton import load_skeleton
from ha2g_jax.synthesis import Style

WORDS, SPEAKERS = ["the", "Hand", "hand"], ["a", "b"]


def _parts(rows, shapes):
    """Random tensors for rows of the table, by part and name."""
    rng = np.random.default_rng(0)
    parts = {}
    for row in rows:
        shape = row.conversion.stored(shapes[row.target])
        parts.setdefault(row.part, {})[row.name] = rng.uniform(
            0.1 if "running_var" in row.name else -0.6, 0.6, shape
        ).astype(np.float32)
    return parts


def _shapes(spec):
    names = weights.flatten(variable_shapes(spec))
    shapes = {name: leaf.shape for name, leaf in names.items()}
    for name, leaf in weights.flatten(discriminator_shapes(spec)).items() if spec.discriminator else ():
        collection, _, path = name.partition("/")
        shapes[f"{collection}/{table.DISCRIMINATOR}/{path}"] = leaf.shape
    return shapes


@pytest.fixture(scope="module")
def ha2g():
    """The parts of a small file of HA2G."""
    config = presets.make("ted_gesture", "debug", "release")
    spec = build(config, load_skeleton("ted_gesture"), len(WORDS) + 2, len(SPEAKERS))
    return _parts(table.ha2g(config, 3), _shapes(spec))


@pytest.fixture
def content(ha2g):
    """The value of a small file of HA2G, which a test may change."""
    mean = [[float(value)] for value in load_skeleton("ted_gesture").mean_directions.ravel() + 1]
    return {
        "args": Inert("argparse.Namespace", {"mean_dir_vec": mean, "n_poses": 34}),
        "epoch": 3,
        "pose_dim": 27,
        "lang_model": Inert("module.Words", {"word2index": {word: 4 + i for i, word in enumerate(WORDS)}}),
        "speaker_model": Inert("module.Words", {"index2word": {1 + i: name for i, name in enumerate(SPEAKERS)}}),
        **{part: dict(entries) for part, entries in ha2g.items()},
    }


@pytest.fixture(scope="module")
def autoencoder():
    """The value of a file of the auto-encoder of TED-Gesture."""
    config = presets.make("ted_gesture", "", "autoencoder", {"model.architecture": "release"})
    rows = table.autoencoder("gen_dict", "pose_encoder", has_mean=True)
    return {"pose_dim": 27} | _parts(rows, _shapes(build(config, load_skeleton("ted_gesture"), 2, 0)))


def test_a_mean_pose_that_float32_cannot_hold_is_not_used(content):
    content["args"].state["mean_dir_vec"] = [1e300] * 27
    found = read_released(content, "debug")
    assert any("no mean directions" in note for note in found.notes)


def test_names_statistics_and_styles_come_with_the_weights(content):
    found = read_released(content, "debug")
    assert found.assets.vocabulary.words == ("the", "Hand", "hand")  # "Hand" is never looked for
    np.testing.assert_allclose(
        found.assets.skeleton.mean_directions, load_skeleton("ted_gesture").mean_directions + 1, rtol=1e-6
    )
    words = content["gen_dict_2"]["text_encoder.embedding.weight"]
    ours = found.variables["params"]["pose_2"]["text"]["embedding"]["embedding"]
    np.testing.assert_array_equal(ours, words[[0, 3, 4, 5, 6]])  # padding, unknown, words
    rows = content["gen_dict_1"]["speaker_embedding.0.weight"]
    np.testing.assert_array_equal(found.variables["params"]["pose_1"]["identity"]["embedding"]["embedding"], rows[1:])
    assert {name: style.shape for name, style in found.assets.speakers.items()} == {"a": (64,), "b": (64,)}
    assert np.isfinite(found.assets.seed_poses).all()
    assert len(found.notes) == 1 and "of dis_dict fit, and are left out" in found.notes[0]


def test_second_names_and_counters_may_be_there(content):
    level = content["gen_dict_1"]
    for name in list(level):
        if ".conv1." in name:
            level[name.replace("conv1", "net.0")] = level[name]
        if ".conv2." in name:
            level[name.replace("conv2", "net.4")] = level[name]
    content["audio_dict"]["feat_extractor.bn1.num_batches_tracked"] = np.array(5)
    assert any("7 entries have no place" in note for note in read_released(content, "debug").notes)
    level["text_encoder.tcn.network.0.net.0.bias"] = np.zeros_like(level["text_encoder.tcn.network.0.conv1.bias"])
    with pytest.raises(DoesNotFitError, match=r"gen_dict_1: text_encoder\.tcn\.network\.0\.net\.0\.bias"):
        read_released(content, "debug")


def test_a_file_without_names_is_numbered_and_says_so(content):
    for key in ("args", "lang_model", "speaker_model", "dis_dict"):
        del content[key]
    content["extra"] = 1
    found = read_released(content, "debug")
    assert list(found.assets.speakers) == ["<1>", "<2>"] and found.assets.vocabulary.words == ("<4>", "<5>", "<6>")
    assert [note.split()[0] for note in found.notes] == ["the", "lang_model", "speaker_model", "not"]


def test_a_model_folder_generates_motion_with_words(content, tmp_path):
    found = read_released(content, "debug")
    folder = model_folder.save(tmp_path / "model", found.config, found.assets, found.variables, is_exact=True)
    model = ha2g_jax.load(folder)
    assert model.name == "released_ha2g" and model.reads_words
    speech = 0.1 * np.random.default_rng(0).normal(size=3 * SAMPLE_RATE).astype(np.float32)
    motions = [
        model.generate(speech, words=words, style=Style(speaker="a", variation=0))
        for words in ((), (Word("the", 0.5, 0.8), Word("hand", 1.0, 1.4)))
    ]
    assert all(motion.directions.shape == (45, 9, 3) and np.isfinite(motion.directions).all() for motion in motions)
    assert not np.allclose(motions[0].directions, motions[1].directions)
    with pytest.raises(UserError, match="networks of the public code"):
        export.export(folder, tmp_path / "model.onnx")
    with pytest.raises(UserError, match="ha2g reads mel, words"):
        model.stream()


def _set(content, part, name, value):
    content[part][name] = value


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda it: it["gen_dict_2"].pop("out.0.bias"), r"no tensor 'gen_dict_2: out\.0\.bias'$"),
        (lambda it: _set(it, "dis_dict", "more", np.ones(3)), "'dis_dict: more' is in no row"),
        (
            lambda it: _set(it, "gen_dict_2", "out.2.bias", np.ones(4, np.float32)),
            r"'gen_dict_2: out\.2\.bias' has shape \(4,\), expected \(21,\)",
        ),
        (
            lambda it: _set(it, "gen_dict_2", "out.2.bias", np.full(21, np.nan, np.float32)),
            r"'gen_dict_2: out\.2\.bias' has values that are not finite",
        ),
        (
            lambda it: _set(it, "gen_dict_2", "out.2.bias", np.full(21, 1e300)),
            r"'gen_dict_2: out\.2\.bias' has values that are not finite",
        ),
        (lambda it: it.update(pose_dim=30), "pose_dim is 30, expected 27"),
        (lambda it: it.update(pose_dim="27"), "pose_dim is '27', expected 27"),
    ],
)
def test_what_does_not_fit_is_named(change, message, content):
    change(content)
    with pytest.raises(DoesNotFitError, match=message):
        read_released(content, "debug")
    with pytest.raises(DoesNotFitError, match="a list instead of a mapping"):
        read_released([])


@pytest.mark.parametrize("entry", [{0: np.ones(2, np.float32)}, {"conv.weight": [1.0]}])
def test_entries_of_other_kinds_fit_no_baseline(entry):
    with pytest.raises(DoesNotFitError):
        read_released({"pose_dim": 27, "gen_dict": entry})


def test_an_auto_encoder_becomes_a_model_folder_that_measures_motion(autoencoder, torch_files, tmp_path, capsys):
    rng = np.random.default_rng(0)
    unused = {"pose_encoder.fc_logvar.weight": np.ones((32, 32)), "pose_encoder.fc_logvar.bias": np.ones(32)}
    tensors = {name: torch_files.Tensor(array) for name, array in (autoencoder["gen_dict"] | unused).items()}
    value = {"pose_dim": 27, "args": argparse.Namespace(rate=1.0), "gen_dict": tensors}
    source = torch_files.Archive(value).save(tmp_path / "autoencoder.bin")
    assert main(["import-weights", str(source), "-o", str(tmp_path / "model")]) == 0
    printed = capsys.readouterr()
    assert printed.out == f"{tmp_path / 'model'}\n" and "2 entries have no place" in printed.err
    loaded = model_folder.load(tmp_path / "model")
    expected = read_released(autoencoder)
    jax.tree.map(np.testing.assert_array_equal, loaded.variables, expected.variables)
    latents = PoseFeatures(tmp_path / "model")(rng.normal(size=(2, 34, 9, 3)))
    assert latents.shape == (2, 32) and np.isfinite(latents).all()

    del tensors["decoder.net.7.bias"]
    source = torch_files.Archive(value).save(tmp_path / "part.bin")
    assert main(["import-weights", str(source), "-o", str(tmp_path / "other")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "no tensor 'gen_dict: decoder.net.7.bias'" in line
    assert not (tmp_path / "other").exists()
