"""The graph of ONNX computes the windows of `generate_window`, with native operators, for any choice of a config."""

import dataclasses
import json
import shutil

import jax
import numpy as np
import onnx
import onnxruntime
import pytest

from ha2g_jax import cli
from ha2g_jax.checkpoint import model_folder
from ha2g_jax.checkpoint.assets import Assets
from ha2g_jax.checkpoint.model_folder import LoadedModel
from ha2g_jax.checkpoint.onnx import reading
from ha2g_jax.checkpoint.onnx.export import build, export
from ha2g_jax.checkpoint.onnx.reading import from_metadata, to_metadata
from ha2g_jax.config import presets
from ha2g_jax.config import settings as configs
from ha2g_jax.errors import UserError
from ha2g_jax.features.spectrum import window_columns
from ha2g_jax.features.text import Vocabulary
from ha2g_jax.methods import build as build_spec
from ha2g_jax.methods import variable_shapes
from ha2g_jax.skeleton import load_skeleton, normalize
from ha2g_jax.synthesis.scan import generate_window

# Of float32; the others store weights with 11 and 8 bits.
ERRORS = {"float32": 1e-4, "float16": 5e-3, "int8": 0.1}


@pytest.fixture(scope="module")
def debug(debug_folder):
    return model_folder.load(debug_folder)


def draw(config, scale=0.2):
    """Return a model of a config with random weights, normalisations among them that change each channel."""
    skeleton, random = load_skeleton(config.skeleton), np.random.default_rng(1)
    spec = build_spec(config, skeleton, 2, 2)
    shapes = variable_shapes(spec)
    variables = {
        "params": jax.tree.map(lambda x: random.normal(0, scale, x.shape).astype(np.float32), shapes["params"]),
        "batch_stats": jax.tree.map(
            lambda x: random.uniform(0.5, 1.5, x.shape).astype(np.float32), shapes["batch_stats"]
        ),
    }
    starts = skeleton.mean_directions + random.normal(0, 0.1, (2, spec.num_seed_frames, skeleton.num_bones, 3))
    styles = {"ada": random.normal(size=spec.style_dim).astype(np.float32)}
    assets = Assets(skeleton, Vocabulary(("one", "two")), styles, normalize(starts.astype(np.float32)), "ab12")
    return LoadedModel(spec, variables, assets, config)


def inputs_of(loaded, batch):
    """Return random inputs of several windows."""
    spec, random = loaded.spec, np.random.default_rng(2)
    columns = window_columns(spec.num_frames, spec.fps)
    poses = normalize(random.normal(size=(batch, spec.num_seed_frames, spec.skeleton.num_bones, 3)))
    inputs = {
        "mel": random.uniform(-80, 0, (batch, 128, columns)).astype(np.float32),
        "style": random.normal(size=(batch, spec.style_dim)).astype(np.float32),
        "seed_pose": poses.astype(np.float32),
    }
    if spec.noise_dim:
        inputs["noise"] = random.normal(size=(batch, spec.num_frames, spec.noise_dim)).astype(np.float32)
    return inputs


def run(model, inputs):
    session = onnxruntime.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"])
    return np.asarray(session.run(["poses"], inputs)[0])


def by_jax(loaded, inputs):
    """Return the poses of the windows one by one."""
    noise = inputs.get("noise", np.zeros((len(inputs["mel"]), loaded.spec.num_frames, 0), np.float32))
    parts = zip(inputs["mel"], inputs["style"], inputs["seed_pose"], noise, strict=True)
    return np.stack([generate_window(loaded.spec, loaded.variables, {"mel": mel}, *rest) for mel, *rest in parts])


@pytest.mark.parametrize("weights", ERRORS)
def test_windows_are_those_of_jax_in_a_batch_of_any_size(debug, weights):
    model = build(debug, weights=weights)
    onnx.checker.check_model(model, full_check=True)
    inputs = inputs_of(debug, 3)
    expected = by_jax(debug, inputs)
    poses = run(model, inputs)
    assert poses.shape == expected.shape == (3, 34, 42, 3)
    assert np.abs(poses - expected).max() < ERRORS[weights]
    one = run(model, {name: value[1:2] for name, value in inputs.items()})
    np.testing.assert_allclose(one, poses[1:2], atol=1e-5)


def test_a_constant_channel_leaves_int8_weights_their_precision():
    """Its factor in the normalisation of a head is hundreds of times those of the other channels."""
    loaded = draw(presets.make("talk", "debug"))
    variables = jax.tree.map(np.array, loaded.variables)
    head, stats = variables["params"]["audio"]["low"], variables["batch_stats"]["audio"]["low"]["norm"]
    head["conv"]["kernel"][..., 0], head["conv"]["bias"][0] = 0, 1
    stats["mean"][0], stats["variance"][0] = 1, 0
    inputs, features = inputs_of(loaded, 1), {}
    for weights in ("float32", "int8"):
        model = build(loaded._replace(variables=variables), weights=weights)
        model.graph.output[0].name = "f_low"
        del model.graph.output[0].type.tensor_type.shape.dim[:]
        session = onnxruntime.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"])
        features[weights] = np.asarray(session.run(["f_low"], inputs)[0])
    error = np.abs(features["int8"] - features["float32"]).max()
    assert error < 0.1 * features["float32"].std()


def other_config(method="ha2g"):
    """Return a config with a choice other than the default wherever the networks have one."""
    config = configs.change(configs.paper("ted_gesture", method), presets.SIZES["debug"])
    config.data.update(fps=20, num_frames=40, num_seed_frames=6)  # the columns of the heads are interpolated
    config.data.lookahead = 0.5
    config.model.identity.kind = "speakers"
    config.model.audio.resnet_se.blocks = (1, 2, 1, 1)
    config.model.audio.levels = ("low", "high")
    config.model.inferer.levels = (1, 3)
    config.model.inferer.coordinator = "tied"
    config.model.inferer.layers = 2
    return config


@pytest.mark.parametrize("method", ["ha2g", "energy_ha2g"])
def test_all_choices_of_a_config_are_exported(method):
    loaded = draw(other_config(method))
    inputs = inputs_of(loaded, 2)
    model = build(loaded)
    np.testing.assert_allclose(run(model, inputs), by_jax(loaded, inputs), atol=1e-4)
    description = from_metadata(metadata_of(model))
    assert description.has_hidden_ends and description.noise_dim == loaded.spec.noise_dim
    onnx.checker.check_model(model, full_check=True)
    if method != "ha2g":
        moved = inputs | {"noise": inputs["noise"][::-1]}
        assert np.abs(run(model, moved) - run(model, inputs)).max() > 0.01


def metadata_of(model):
    return {it.key: it.value for it in model.metadata_props}


def test_the_metadata_restores_the_description(debug):
    model = build(debug, weights="float16", license="CC0-1.0")
    found = from_metadata(metadata_of(model))
    assert (found.name, found.method, found.weights, found.license) == ("ha2g", "ha2g", "float16", "CC0-1.0")
    assert (found.num_frames, found.num_seed_frames, found.fps, found.style_dim) == (34, 4, 15, 18)
    assert found.assets.hash == debug.assets.hash and not found.has_hidden_ends
    assert found.assets.skeleton == debug.assets.skeleton
    np.testing.assert_array_equal(found.assets.seed_poses, debug.assets.seed_poses)
    assert list(found.assets.speakers) == ["ada", "ben"]
    np.testing.assert_array_equal(found.assets.speakers["ben"], debug.assets.speakers["ben"])
    assert to_metadata(found) == metadata_of(model)


def test_the_forms_of_weights_have_the_sizes_they_should(debug):
    wide = debug.config.copy_and_resolve_references()
    wide.model.inferer.hidden_dim = 64
    loaded = draw(wide)
    whole, half, quarter = (
        sum(len(it.raw_data) for it in build(loaded, weights=name).graph.initializer) for name in ERRORS
    )
    assert 0.45 < half / whole < 0.6 and 0.22 < quarter / whole < 0.35


def test_other_models_are_refused_by_name():
    with pytest.raises(UserError, match="the model is of seq2seq; only HA2G"):
        build(draw(presets.parse("talk:debug", "seq2seq")))
    with pytest.raises(UserError, match="the model is a control of HA2G"):
        build(draw(presets.make("talk", "debug", changes=presets.CONTROLS[presets.NO_COORDINATOR])))


def test_what_could_not_be_read_is_not_written(debug_folder, tmp_path, monkeypatch):
    monkeypatch.setattr(reading, "MAX_ONNX_METADATA_BYTES", 1000)
    with pytest.raises(UserError, match=r"too large for an ONNX file \(more than 1000 characters of metadata\); train"):
        export(debug_folder, tmp_path / "model.onnx")
    for text in ("MIT\nor more", 201 * "x"):
        with pytest.raises(UserError, match=r"the licence .* give at most 200 characters of one line"):
            export(debug_folder, tmp_path / "model.onnx", license=text)
    assert not list(tmp_path.iterdir())
    config = shutil.copytree(debug_folder, tmp_path / "named") / "config.json"
    config.write_text(json.dumps(json.loads(config.read_text()) | {"name": 201 * "x"}))
    with pytest.raises(UserError, match=r"the name of the model .* at most 200 characters of one line"):
        export(tmp_path / "named", tmp_path / "model.onnx")


def test_a_model_folder_is_exported_as_one_file_and_for_a_page_with_its_description(debug, debug_folder, tmp_path):
    path = tmp_path / "new" / "model.onnx"
    assert cli.main(["model", "onnx", str(debug_folder), "-o", str(path)]) == 0
    assert [it.name for it in path.parent.iterdir()] == ["model.onnx"]
    assert cli.main(["model", "onnx", str(debug_folder), "-o", str(path), "--page"]) == 0
    about = json.loads((path.parent / "model.json").read_text())
    assert about["speakers"].keys() == debug.assets.speakers.keys() and len(about["takes"]) == 100
    found = from_metadata(metadata_of(onnx.load(path)))
    assert found.assets.hash == debug.assets.hash and found.license == ""
    assert dataclasses.asdict(found.assets)["vocabulary"] == {"words": ()}
