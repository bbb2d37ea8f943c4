"""What oneDNN computes is what XLA computes, with the same gradients, and training uses it where it is installed."""

import contextlib
import ctypes
import importlib.metadata
import os
import re
import shutil
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fixtures.convolutions import ANY_SHAPE, SHAPES, direct_conv
from hypothesis import given, settings

from ha2g_jax.layers.cpu import convolution, onednn
from ha2g_jax.layers.cpu.onednn import library
from ha2g_jax.layers.gru_cell import Gates
from ha2g_jax.layers.gru_scan import gru_scan
from ha2g_jax.train.measure import count_operations

try:
    importlib.metadata.version("onednn-cpu-gomp")
except importlib.metadata.PackageNotFoundError:
    pytest.skip("the extra onednn is not installed", allow_module_level=True)
if shutil.which("c++") is None:
    pytest.skip("there is no C++ compiler", allow_module_level=True)


@pytest.fixture(scope="module", autouse=True)
def calls_of_onednn():
    library.register()


@pytest.fixture
def use():
    """Return a function that sets whether functions traced from now on in this test use oneDNN."""
    with contextlib.ExitStack() as stack:
        yield lambda is_used: stack.enter_context(library.choosing(is_used))


def drawn(*shape, seed=0):
    return jnp.asarray(np.random.default_rng(seed).normal(size=shape), jnp.float32)


def assert_close(found, true, tolerance=1e-5):
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
        lambda x, kernel, conv=conv: conv(x, kernel, stride, padding) for conv in (onednn.conv, convolution._native)
    ]
    return programs, (drawn(batch, *edges, inputs), kernels)


@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_convolutions_of_the_networks(shape):
    height, width, *others = shape
    (conv, native), arguments = both(3, (height, width), *others)  # a batch that two threads cannot divide equally
    assert_close(jax.jit(conv)(*arguments), jax.jit(native)(*arguments))
    assert_close(jax.jit(gradients(conv))(*arguments), jax.jit(gradients(native))(*arguments))


@settings(max_examples=15, deadline=None)
@given(**ANY_SHAPE)
def test_gradients_of_gradients_of_any_shape(batch, edges, values, kernel, stride, padding):
    (conv, _), arguments = both(batch, edges, values[0], values[1], kernel, stride, padding)
    true = gradients(gradients(lambda x, kernel: direct_conv(x, kernel, stride, padding)))
    assert_close(jax.jit(gradients(gradients(conv)))(*arguments), jax.jit(true)(*arguments), 1e-4)


def test_nothing_beside_the_arrays_is_written():
    """A strided kernel of one pixel damaged the heap below eight channels, as at the size debug."""
    checker = "libc_malloc_debug.so.0"
    try:
        ctypes.CDLL(checker)
    except OSError:
        pytest.skip(f"no {checker} here")
    program = """
import jax, jax.numpy as jnp
from ha2g_jax.layers.cpu import onednn
from ha2g_jax.layers.cpu.onednn.library import is_available
assert is_available()
for inputs, kernel, stride, padding in ((4, 1, 2, 0), (3, 1, 3, 1), (4, 3, 2, 1), (5, 1, 1, 0)):
    total = lambda x, kernel: onednn.conv(x, kernel, (stride, stride), padding).sum()
    gradient = jax.jit(jax.grad(total, (0, 1)))
    for _ in range(30):
        jax.block_until_ready(gradient(jnp.ones((4, 8, 8, inputs)), jnp.ones((kernel, kernel, inputs, 8))))
"""
    flags = {"XLA_FLAGS": "", "HA2G_ONEDNN": "1", "LD_PRELOAD": checker, "MALLOC_CHECK_": "3"}
    done = subprocess.run(
        [sys.executable, "-c", program], env=os.environ | flags, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


def recurrence(steps, batch, width):
    """Return the arguments of `gru_scan` for two GRUs."""

    def two(*shape):
        return tuple(drawn(*shape, seed=seed) / np.sqrt(width) for seed in range(2))

    def gates(*shape):
        return tuple(Gates(*it) for it in two(3, *shape))

    return gates(steps, batch, width), gates(width, width), two(width)


def results(function, arguments, use):
    """Return the results with oneDNN and without it; a new function for each, since JAX keeps what it has traced."""
    found = []
    for is_used in (True, False):
        use(is_used)
        found.append(jax.jit(lambda *arguments: function(*arguments))(*arguments))
    return found


def calls_in(function, *arguments):
    """Return the names of the calls of oneDNN in a function."""
    return set(re.findall(r"Ha2g\w+", jax.jit(lambda *it: function(*it)).lower(*arguments).as_text()))


@pytest.mark.parametrize(("steps", "batch", "width"), [(4, 3, 5), (7, 9, 64), (8, 2, 300)])
def test_recurrence_and_its_gradients_of_both_orders(steps, batch, width, use):
    arguments, function = recurrence(steps, batch, width), gru_scan
    for tolerance in (2e-6, 1e-5, 2e-4):
        found, true = results(function, arguments, use)
        assert_close(found, true, tolerance)
        function = gradients(function)


def test_recurrence_under_transformations(use):
    arguments = recurrence(4, 3, 5)
    batches = jax.tree.map(lambda leaf: jnp.stack([leaf, -leaf]), arguments)
    assert_close(*results(jax.vmap(gru_scan), batches, use))
    assert_close(*results(gradients(jax.checkpoint(gru_scan)), arguments, use))


def test_a_state_that_is_not_finite_stays_so(use):
    gates, *others = recurrence(3, 2, 5)
    gates = jax.tree.map(lambda leaf: leaf.at[1, 0].set(jnp.array([np.nan, np.inf, -np.inf, 1e30, -1e30])), gates)
    found, true = results(gru_scan, (gates, *others), use)
    for one, other in zip(found, true, strict=True):
        np.testing.assert_array_equal(np.isfinite(one), np.isfinite(other))


def test_repeated_gradients_are_the_same_bits(use):
    (conv, _), arguments = both(5, (16, 9), 64, 64, (3, 3), (1, 1), 1)
    use(True)
    for function, values in ((conv, arguments), (gru_scan, recurrence(7, 9, 64))):
        step = jax.jit(gradients(function))
        first = jax.tree.leaves(step(*values))
        for _ in range(5):
            assert all(map(np.array_equal, first, jax.tree.leaves(step(*values))))


def test_what_is_computed_with_onednn(use):
    def conv(x, kernel):
        return convolution.conv(x, kernel, (1, 1), 1)

    x, kernel = drawn(2, 8, 8, 4), drawn(3, 3, 4, 4)
    gates, kernels, biases = recurrence(4, 3, 5)
    half = [it.astype(jnp.bfloat16) for it in (x, kernel)]
    is_real = (jnp.ones((4, 3, 1), bool),) * 2
    use(True)
    all_of_conv = {"Ha2gConv", "Ha2gConvInputGradient", "Ha2gConvKernelGradient"}
    assert calls_in(lambda *it: (conv(*it), gradients(conv)(*it)), x, kernel) == all_of_conv
    assert calls_in(gradients(gru_scan), gates, kernels, biases) == {"Ha2gGruStates", "Ha2gGruSums"}
    assert not calls_in(conv, *half)
    assert not calls_in(conv, x[:0], kernel) and not calls_in(conv, x[:, :0], kernel)  # no output
    assert not calls_in(lambda *it: gru_scan(*it, is_real=is_real), gates, kernels, biases)  # padding
    use(False)
    assert not calls_in(conv, x, kernel)


def test_operations_are_counted_as_those_of_xla(use):
    programs, arguments = both(3, (9, 8), 5, 4, (3, 3), (1, 1), 1)
    use(True)
    assert [count(gradients(it), *arguments) for it in programs] == [3 * 2 * (3 * 9 * 8) * (3 * 3 * 5 * 4)] * 2
    values = recurrence(4, 3, 5)
    with_onednn = count(gradients(gru_scan), *values)
    use(False)
    assert with_onednn == count(gradients(gru_scan), *values) > 0


def count(function, *arguments):
    return count_operations(jax.jit(lambda *it: function(*it)).trace(*arguments).jaxpr.jaxpr)


def new_process(tmp_path, **variables):
    """Prepare a new process for training; return the version of oneDNN, the number of cores and the standard error."""
    program = """
import os
from ha2g_jax.launch import prepare_process
prepare_process()
import jax
assert not jax._src.xla_bridge.backends_are_initialized()  # else processes could not join each other
from ha2g_jax.layers.cpu.onednn.library import used_version
print(used_version(), len(os.sched_getaffinity(0)))
"""
    flags = {"XLA_FLAGS": "", "HA2G_ONEDNN": "1", "HA2G_CACHE": str(tmp_path)}
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, env=os.environ | flags | variables, capture_output=True, text=True, check=True)
    version, cores = done.stdout.split()
    return version, int(cores), done.stderr


def test_the_calls_are_compiled_once(tmp_path):
    cores = len(os.sched_getaffinity(0))
    version, _, message = new_process(tmp_path)
    assert version[0] == "3" and "compiling" in message
    assert new_process(tmp_path, OMP_PROC_BIND="true") == (version, cores, "")


def test_several_devices_and_a_refusal_leave_xla_at_work(monkeypatch):
    is_available = library.is_available.__wrapped__  # without what this process remembers
    monkeypatch.setenv("HA2G_ONEDNN", "1")
    assert jax.device_count() > 1 and not is_available()
    monkeypatch.setattr(jax, "device_count", lambda: 1)
    assert is_available()
    monkeypatch.setenv("HA2G_ONEDNN", "0")
    assert not is_available()


def test_training_goes_on_where_the_calls_cannot_be_made(tmp_path):
    version, _, message = new_process(tmp_path, CXX="false")
    assert version == "None"
    assert "does not compile" in message and message.splitlines()[-1].startswith("ha2g: without oneDNN: ")
    assert not list(tmp_path.glob("onednn/*.so"))
