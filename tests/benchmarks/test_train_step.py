"""The comparison with PyTorch refuses in one line what it cannot compare."""

import importlib.util
import pathlib
import runpy

import pytest

SCRIPT = pathlib.Path(__file__).parents[2] / "benchmarks" / "train_step.py"


@pytest.fixture
def run(monkeypatch, capsys):
    """A function from arguments of the script to its exit code and what it prints to stderr."""
    monkeypatch.syspath_prepend(str(SCRIPT.parent))
    main = runpy.run_path(str(SCRIPT))["main"]

    def call(*arguments):
        monkeypatch.setattr("sys.argv", ["train_step.py", "--config", "ted_gesture:debug", *arguments])
        return main(), capsys.readouterr().err

    return call


def test_names_the_extra_that_installs_pytorch(run, monkeypatch):
    find_spec = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *_: None if name == "torch" else find_spec(name))
    code, error = run("--against", "torch")
    assert code == 2
    assert error == "train_step: PyTorch is not installed; install the extra: pip install 'ha2g-jax[torch]'\n"


def test_compares_one_variant(run, monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda *_: True)
    code, error = run("--against", "torch", "--batch-size", "2", "4")
    assert (code, error) == (2, "train_step: --against compares one variant, not 2; give each setting one value\n")


def test_needs_a_device_that_pytorch_has(run, monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda *_: True)
    monkeypatch.setattr("jax.default_backend", lambda: "tpu")
    code, error = run("--against", "torch")
    expected = "train_step: JAX computes on tpu, where PyTorch has no step; set JAX_PLATFORMS=cpu\n"
    assert (code, error) == (2, expected)
