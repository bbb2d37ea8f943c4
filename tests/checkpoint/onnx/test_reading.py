"""ONNX files that are damaged, hostile or of another kind are refused in one line before a runtime sees them."""

import subprocess
import sys

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper
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


def with_nodes(model, *nodes, **constants):
    """Add nodes before the others, operators with their inputs; the output of each is its number."""
    for name, values in constants.items():
        model.graph.initializer.append(numpy_helper.from_array(np.asarray(values), name))
    for number, (op, inputs, attributes) in reversed(list(enumerate(nodes))):
        model.graph.node.insert(0, helper.make_node(op, inputs, [str(number)], name=f"n{number}", **attributes))


def doubled(start):
    """Return a damage: the value `start` doubled by 28 nodes, whose sizes the file states wrongly."""

    def damage(model):
        names = [start, *map(str, range(28))]
        with_nodes(model, *(("Concat", [name] * 2, {"axis": 1}) for name in names[:-1]), c=np.ones((1, 64), np.float32))
        for name in names[1:]:
            model.graph.value_info.append(helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, 64]))

    return damage


def padded(*pads):
    return lambda model: with_nodes(model, ("Pad", ["style", "pads"], {}), pads=np.array(pads))


def multiplied(rows):
    """Return a damage: matrices of one or many rows multiplied 20,000 times."""

    def damage(model):
        sides = {"rows": np.ones((rows, 500), np.float32), "matrix": np.ones((500, 500), np.float32)}
        names = ["rows", *map(str, range(19_999))]
        with_nodes(model, *(("MatMul", [name, "matrix"], {}) for name in names), **sides)

    return damage


def of_computed_size(model):
    with_nodes(model, ("Cast", ["style"], {"to": 7}), ("Pad", ["mel", "0"], {}))


def with_a_large_kernel(model):
    kernel = np.ones((4, 1, 400, 400), np.float32)
    nodes = ("Unsqueeze", ["style", "axes"], {}), ("Pad", ["0", "pads"], {}), ("Conv", ["1", "kernel"], {})
    with_nodes(model, *nodes, axes=[1, 2], pads=[0, 0, 0, 0, 0, 0, 999, 999], kernel=kernel)


def with_a_long_sequence(model):
    constants = {name: np.ones((1, 900, 300), np.float32) for name in "wr"} | {"x": np.ones((20_000, 1, 300), "f")}
    with_nodes(model, ("GRU", ["x", "w", "r"], {"hidden_size": 300}), **constants)


def with_one_wide_kernel(model):
    constants = {"x": np.ones((1, 1, 300, 300), np.float32), "w": np.ones((1, 1, 130, 130), np.float32)}
    with_nodes(model, ("Conv", ["x", "w"], {"pads": [200] * 4}), **constants)


def with_many_steps(model):
    constants = {name: np.ones((1, 3, 1), np.float32) for name in "wr"} | {"x": np.ones((4_000_000, 1, 1), "f")}
    with_nodes(model, ("GRU", ["x", "w", "r"], {"hidden_size": 1}), **constants)


def with_many_small_products(model):
    with_nodes(model, ("MatMul", ["x", "x"], {}), x=np.ones((4_000_000, 1, 1), np.float32))


def with_a_large_constant(model):
    """Of 360 MB, and computed before the first window, for which it is there three times."""
    with_nodes(model, ("Add", ["x", "y"], {}), x=np.ones((9500, 1), np.float32), y=np.ones((1, 9500), np.float32))


def with_a_weight_that_is_not_there(model):
    model.graph.initializer[0].dims[0] += 1


DAMAGES = {
    doubled("c"): "a window takes .* bytes",
    doubled("style"): "a window takes .* bytes",
    padded(0, 0, 0, 2**31): "an integer above 1073741824",
    padded(0, 2**62, 0, 2**62): "an integer above 1073741824",
    padded(0, 0, 0, 2**30): "a window takes .* bytes",
    multiplied(1): "bytes and .* multiplications",
    multiplied(500): "bytes and .* multiplications",
    of_computed_size: "depends on its values",
    with_a_large_kernel: "bytes and .* multiplications",
    with_a_long_sequence: "bytes and .* multiplications",
    with_one_wide_kernel: "bytes and .* multiplications",
    with_many_steps: "bytes and .* multiplications",
    with_many_small_products: "bytes and .* multiplications",
    with_a_large_constant: "a window takes .* bytes",
    with_a_weight_that_is_not_there: "weights of shape",
    lambda model: setattr(model, "doc_string", "x" * 2**20): "more than 1048576 bytes beside weights",
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
    lambda model: model.metadata_props.add(key="noise_dim", value="1000000"): "noise_dim is 1000000",
    lambda model: model.metadata_props.add(key="noise_dim", value="16"): "are not mel, style, seed_pose, noise",
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


def test_what_the_runtime_refuses_is_said_in_one_line(model, tmp_path, capfd):
    from ha2g_jax.synthesis import load_onnx

    model.ir_version = 99
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


# Starts a command from a small process, as the peak of a process begins at that of the one that starts it, on Linux.
MEASURED = """
import resource, subprocess, sys
done = subprocess.run(sys.argv[1:])
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)  # KiB
sys.exit(done.returncode)
"""


@pytest.mark.parametrize("message", [b"\x0a\x00", b"\x2a\x00"], ids=["nodes", "weights"])
def test_millions_of_empty_messages_take_no_memory(tmp_path, message):
    """Each is of two bytes in the file and a hundred in memory: read in a process of its own."""
    count = 15_000_000
    size, digits = 2 * count, b""
    while size:
        digits, size = digits + bytes([size & 127 | (128 if size > 127 else 0)]), size >> 7
    (tmp_path / "model.onnx").write_bytes(b"\x3a" + digits + message * count)
    (tmp_path / "a.wav").write_bytes(b"RIFF")
    command = [sys.executable, "-m", "ha2g_jax.cli", "generate", "a.wav", "--checkpoint", "model.onnx"]
    measured = [sys.executable, "-c", MEASURED, *command]
    done = subprocess.run(measured, cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert done.returncode == 2 and "bytes beside weights and metadata" in done.stderr
    assert int(done.stdout) < 700_000
