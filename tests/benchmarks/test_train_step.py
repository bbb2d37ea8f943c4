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


@pytest.mark.parametrize(
    ("has_torch", "backend", "sizes", "message"),
    [
        (False, "cpu", ["2"], "PyTorch is not installed; install the extra: pip install 'ha2g-jax[torch]'"),
        (True, "cpu", ["2", "4"], "--against compares one variant, not 2; give each setting one value"),
        (True, "tpu", ["2"], "JAX computes on tpu, where PyTorch has no step; set JAX_PLATFORMS=cpu"),
    ],
)
def test_what_cannot_be_compared_is_one_line(run, monkeypatch, has_torch, backend, sizes, message):
    find_spec = importlib.util.find_spec
    torch = object() if has_torch else None
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *_: torch if name == "torch" else find_spec(name))
    monkeypatch.setattr("jax.default_backend", lambda: backend)
    assert run("--against", "torch", "--batch-size", *sizes) == (2, f"train_step: {message}\n")
