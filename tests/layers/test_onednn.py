"""What oneDNN computes is what XLA computes, with the same gradients, and training uses it where it is installed."""

import os
import subprocess
import sys
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ha2g_jax.layers import conv as convolution
from ha2g_jax.layers.gru_scan import Gates, gru_scan
from ha2g_jax.layers.onednn import calls, library

pytestmark = pytest.mark.skipif(not library.is_installed(), reason="oneDNN is not installed")

# Height, width and inputs of the map, channels, kernel, stride and padding of convolutions of the networks.
SHAPES: list[tuple[Any, ...]] = [
    (128, 70, 1, 32, (3, 3), (1, 1), 1),  # stem of E_a
    (128, 70, 1, 16, (3, 3), (4, 1), 1),  # the same at small size
    (128, 70, 32, 32, (3, 3), (1, 1), 1),
    (128, 70, 32, 64, (3, 3), (2, 2), 1),
    (128, 70, 32, 64, (1, 1), (2, 2), 0),
    (64, 36, 16, 16, (3, 3), (1, 1), 0),  # head
    (64, 35, 64, 64, (2, 2), (1, 1), 0),  # head
    (16, 9, 256, 256, (3, 3), (1, 1), 1),
    (56, 56, 3, 16, (7, 7), (2, 2), 3),  # stem of E_ID
]


@pytest.fixture(scope="module", autouse=True)
def calls_of_onednn():
    library.register()


@pytest.fixture
def use(monkeypatch):
    """Return a function that says whether functions traced from now on use oneDNN, as if there were one device."""
    monkeypatch.setattr(jax, "device_count", lambda: 1)
    return lambda is_used: monkeypatch.setattr(library, "_is_used", is_used)


def drawn(*shape, seed=0):
    return jnp.asarray(np.random.default_rng(seed).normal(size=shape), jnp.float32)


def assert_close(found, true, tolerance=2e-5):
    """Compare arrays relative to the largest value of each."""
    for one, other in zip(*map(jax.tree.leaves, (found, true)), strict=True):
        assert one.shape == other.shape
        np.testing.assert_allclose(one, other, rtol=0, atol=tolerance * np.abs(other).max())


def gradients(function):
    """Return a function of the gradients of the sum of sin(function(*arguments)) by all arguments."""

    def total(arguments):
        return sum(jnp.sum(jnp.sin(leaf)) for leaf in jax.tree.leaves(function(*arguments)))

    return lambda *arguments: jax.grad(total)(arguments)


def both(batch, edges, inputs, channels, kernel, stride, padding):
    """Return oneDNN's and XLA's convolution, and arguments whose outputs are about 1."""
    kernels = drawn(*kernel, inputs, channels, seed=1) / np.sqrt(np.prod(kernel) * inputs)
    programs = [
        lambda x, kernel, conv=conv: conv(x, kernel, stride, padding) for conv in (calls.conv, convolution._native)
    ]
    return programs, (drawn(batch, *edges, inputs), kernels)


@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_convolutions_of_the_networks(shape):
    height, width, *others = shape
    (conv, native), arguments = both(3, (height, width), *others)  # a batch that two threads cannot divide equally
    assert_close(jax.jit(conv)(*arguments), jax.jit(native)(*arguments))
    assert_close(jax.jit(gradients(conv))(*arguments), jax.jit(gradients(native))(*arguments))


@settings(max_examples=15, deadline=None)
@given(
    batch=st.integers(1, 9),
    edges=st.tuples(st.integers(4, 12), st.integers(4, 12)),
    values=st.tuples(st.integers(1, 5), st.integers(1, 5)),
    kernel=st.tuples(st.integers(1, 4), st.integers(1, 4)),
    stride=st.tuples(st.integers(1, 3), st.integers(1, 3)),
    padding=st.integers(0, 3),
)
def test_gradients_of_gradients_of_any_shape(batch, edges, values, kernel, stride, padding):
    programs, arguments = both(batch, edges, *values, kernel, stride, padding)
    conv, native = (jax.jit(gradients(gradients(program))) for program in programs)
    assert_close(conv(*arguments), native(*arguments), 1e-4)


@pytest.mark.parametrize(("steps", "batch", "width"), [(4, 3, 5), (7, 9, 64), (34, 2, 300)])
def test_recurrence_and_its_gradients_of_both_orders(steps, batch, width, use):
    def two(*shape):
        return tuple(drawn(*shape, seed=seed) for seed in range(2))

    def gates(*shape):
        return tuple(Gates(*it) for it in two(3, *shape))

    arguments = (gates(steps, batch, width), gates(width, width), two(width))
    arguments = jax.tree.map(lambda it: it / np.sqrt(width), arguments)
    for order, tolerance in ((0, 2e-6), (1, 2e-5), (2, 2e-4)):
        results = []
        for is_used in (True, False):
            use(is_used)
            function: Any = lambda *arguments: gru_scan(*arguments)  # noqa: E731 - jax.jit knows a function by its object
            for _ in range(order):
                function = gradients(function)
            results.append(jax.jit(function)(*arguments))
        assert_close(results[0], results[1], tolerance)


def test_other_types_and_several_devices_keep_the_programs_of_xla(use, monkeypatch):
    def text(dtype):
        x, kernel = drawn(2, 8, 8, 4).astype(dtype), drawn(3, 3, 4, 4).astype(dtype)
        return jax.jit(lambda: convolution.conv(x, kernel, (1, 1), 1)).lower().as_text()

    use(True)
    assert "Ha2gConv" in text(jnp.float32)
    assert "Ha2gConv" not in text(jnp.bfloat16)
    monkeypatch.setattr(jax, "device_count", lambda: 8)
    assert "Ha2gConv" not in text(jnp.float32)


def version_in_a_new_process(tmp_path, **variables):
    """Return the version of oneDNN that a process uses which prepares itself for training, and its standard error."""
    program = """
from ha2g_jax.train.process import prepare_process
prepare_process()
from ha2g_jax.layers.onednn.library import used_version
print(used_version())
"""
    environment = os.environ | {"HA2G_ONEDNN": "1", "HA2G_CACHE": str(tmp_path), **variables}
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return done.stdout.strip(), done.stderr


def test_the_calls_are_compiled_once(tmp_path):
    version, message = version_in_a_new_process(tmp_path)
    assert version[0] == "3" and "compiling" in message
    assert version_in_a_new_process(tmp_path) == (version, "")
    assert version_in_a_new_process(tmp_path, HA2G_ONEDNN="0") == ("None", "")


@pytest.mark.parametrize(
    ("compiler", "reason"), [("no-such-compiler", "no C++ compiler no-such-compiler"), ("false", "does not compile")]
)
def test_training_goes_on_where_the_calls_cannot_be_compiled(tmp_path, compiler, reason):
    version, message = version_in_a_new_process(tmp_path, CXX=compiler)
    assert version == "None"
    assert reason in message and len(message.splitlines()) <= 2
    assert not list(tmp_path.glob("onednn/*.so"))
