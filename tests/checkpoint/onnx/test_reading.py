"""ONNX files that are damaged, hostile or of another kind are refused in one line before a runtime sees them."""

import onnx
import pytest
from onnx import TensorProto, helper
from onnx.external_data_helper import set_external_data

from ha2g_jax import cli
from ha2g_jax.checkpoint.onnx import reading
from ha2g_jax.errors import UserError


@pytest.fixture(scope="module")
def content(debug_onnx):
    return debug_onnx.read_bytes()


@pytest.fixture
def model(content):
    """A model that a test may damage."""
    return onnx.load_model_from_string(content)


def set_metadata(model, name, value):
    next(it for it in model.metadata_props if it.key == name).value = value


def elsewhere(model):
    """Point the weights of a tensor at a file outside of the folder."""
    tensor = max(model.graph.initializer, key=lambda it: len(it.raw_data))
    set_external_data(tensor, "../../../../etc/passwd")
    tensor.ClearField("raw_data")


def with_loop(model):
    body = helper.make_graph([], "body", [], [])
    model.graph.node.append(helper.make_node("Loop", ["mel"], ["x"], body=body))


def with_other_domain(model):
    model.graph.node.append(helper.make_node("Relu", ["mel"], ["x"], domain="com.evil"))


def with_a_tensor_attribute(model):
    tensor = helper.make_tensor("t", TensorProto.FLOAT, [1], [1.0])
    model.graph.node.append(helper.make_node("Relu", ["mel"], ["x"], value=tensor))


def with_another_input(model):
    model.graph.input[0].name = "sound"


def with_another_shape(model):
    model.graph.input[0].type.tensor_type.shape.dim[2].dim_value = 71


def without_features(model):
    del model.graph.value_info[:]


DAMAGES = {
    elsewhere: "weights in another file",
    with_loop: "the operator 'Loop', which no model",
    with_other_domain: "the operator 'Relu', which no model",
    with_a_tensor_attribute: "an attribute of Relu",
    with_another_input: "inputs and outputs are not mel, style, seed_pose",
    with_another_shape: r"mel has shape \(128, 71\) instead of \(128, 70\)",
    without_features: "not found in value_infos",
    lambda model: model.graph.node.append(model.graph.node[0]): "two values of one name",
    lambda model: model.metadata_props.pop(): "missing in the metadata",
    lambda model: set_metadata(model, "format", "other"): "not written by ha2g model onnx",
    lambda model: set_metadata(model, "num_frames", "1000000"): "num_frames is 1000000",
    lambda model: set_metadata(model, "fps", '"15"'): "not a whole number",
    lambda model: set_metadata(model, "speakers", '{"ada": [1]}'): "the style of 'ada'",
    lambda model: set_metadata(model, "skeleton", "[" * 100_000): "",
    lambda model: set_metadata(model, "name", "a\nb"): "cannot be printed",
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_graph_of_another_kind_is_refused(model, tmp_path, damage):
    damage(model)
    (tmp_path / "model.onnx").write_bytes(model.SerializeToString())
    with pytest.raises(UserError, match=f"model.onnx is not an ONNX file of ha2g model onnx.*{DAMAGES[damage]}"):
        reading.read(tmp_path / "model.onnx")


@pytest.mark.parametrize("cut", [0, 1, 1000, -1000])
def test_a_file_that_is_cut_short_is_refused(content, tmp_path, cut, capsys):
    (tmp_path / "model.onnx").write_bytes(content[:cut])
    (tmp_path / "a.wav").write_bytes(b"RIFF")
    command = ["generate", str(tmp_path / "a.wav"), "--checkpoint", str(tmp_path / "model.onnx")]
    assert cli.main(command) == 2
    captured = capsys.readouterr()
    assert captured.out == "" and captured.err.count("\n") == 1
    assert ("is not an ONNX file" if cut else "is an empty file") in captured.err


def test_weights_that_do_not_fit_are_refused_by_the_runtime_in_one_line(model, tmp_path, capfd):
    from ha2g_jax.synthesis import load_onnx

    tensor = next(it for it in model.graph.initializer if it.name.startswith("stem"))
    tensor.dims[0] += 1
    (tmp_path / "model.onnx").write_bytes(model.SerializeToString())
    with pytest.raises(UserError, match=r"model.onnx cannot be used \(.*\); export the model again"):
        load_onnx(tmp_path / "model.onnx")
    assert capfd.readouterr() == ("", "")


def test_a_folder_a_missing_file_and_a_large_one_are_refused(content, tmp_path, monkeypatch):
    with pytest.raises(UserError, match="no file at"):
        reading.read(tmp_path / "none.onnx")
    with pytest.raises(UserError, match="a folder at"):
        reading.read(tmp_path)
    (tmp_path / "model.onnx").write_bytes(content)
    monkeypatch.setattr(reading, "MAX_ONNX_BYTES", len(content) - 1)
    with pytest.raises(UserError, match="too large for an ONNX file"):
        reading.read(tmp_path / "model.onnx")
