"""Winograd's convolution and the gradient of its kernel are those of XLA, whatever the shape, and can be split."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jax.sharding import NamedSharding, PartitionSpec

from ha2g_jax.layers.cpu import winograd
from ha2g_jax.train import sharding

# Height, width and inputs of the map, channels and padding of convolutions of the networks at the size of the paper.
SHAPES = [
    (128, 70, 32, 32, 1),
    (64, 35, 64, 64, 1),
    (16, 9, 256, 256, 1),
    (64, 36, 32, 32, 0),  # head
    (7, 7, 64, 64, 1),  # E_ID
]


def direct(x, kernel, padding):
    pairs = ((padding, padding), (padding, padding))
    return jax.lax.conv_general_dilated(x, kernel, (1, 1), pairs, dimension_numbers=("NHWC", "HWIO", "NHWC"))


def arrays(batch, height, width, inputs, channels, padding) -> list[jax.Array]:
    """Return an input, a kernel and the gradient of an output."""
    random = np.random.default_rng(0)
    out = (batch, height + 2 * padding - 2, width + 2 * padding - 2, channels)
    shapes = (batch, height, width, inputs), (3, 3, inputs, channels), out
    return [jnp.asarray(random.normal(size=shape), jnp.float32) for shape in shapes]


def assert_equal(found, true):
    assert found.shape == true.shape
    np.testing.assert_allclose(found, true, rtol=0, atol=3e-6 * np.abs(true).max())


def check(batch, height, width, inputs, channels, padding):
    """Compare with direct convolutions in float64: in float32 those of XLA err by up to 2e-5."""
    x, kernel, cotangent = arrays(batch, height, width, inputs, channels, padding)
    with jax.enable_x64(True):
        exact = [np.asarray(array, np.float64) for array in (x, kernel, cotangent)]
        out, transpose = jax.vjp(lambda kernel: direct(exact[0], kernel, padding), exact[1])
        out, (gradient,) = np.asarray(out), map(np.asarray, transpose(exact[2]))
    assert_equal(winograd.conv(x, kernel, padding), out)
    assert_equal(winograd.kernel_gradient(x, cotangent, padding), gradient)


@pytest.mark.parametrize("devices", [1, 8])
@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_each_shape_of_the_networks(shape, devices, monkeypatch):
    """The number of devices decides how many images are transformed at a time."""
    monkeypatch.setattr(jax, "device_count", lambda: devices)
    height, width, inputs, channels, padding = shape
    check(2, height, width, inputs, channels, padding)


@settings(max_examples=15, deadline=None)
@given(
    batch=st.integers(1, 9),
    edges=st.tuples(st.integers(3, 12), st.integers(3, 12)),
    values=st.tuples(st.integers(1, 5), st.integers(1, 5)),
    padding=st.integers(0, 2),
)
def test_any_shape(batch, edges, values, padding):
    check(batch, edges[0], edges[1], values[0], values[1], padding)


def test_a_batch_over_eight_devices_gives_the_values_of_one_and_is_not_gathered():
    x, kernel, cotangent = arrays(16, 8, 6, 3, 4, 1)
    split = NamedSharding(sharding.data_mesh(), PartitionSpec(sharding.AXIS))
    whole = NamedSharding(sharding.data_mesh(), PartitionSpec())
    conv = jax.jit(functools.partial(winograd.conv, padding=1), in_shardings=(split, whole), out_shardings=split)
    gradient = jax.jit(
        functools.partial(winograd.kernel_gradient, padding=1), in_shardings=(split, split), out_shardings=whole
    )
    assert_equal(conv(x, kernel), direct(x, kernel, 1))
    assert_equal(gradient(x, cotangent), winograd.kernel_gradient(x, cotangent, 1))
    for program, arguments in ((conv, (x, kernel)), (gradient, (x, cotangent))):
        assert "all-gather" not in (program.lower(*arguments).compile().as_text() or "")
