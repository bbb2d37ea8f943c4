"""Convolutions and their gradients are those of XLA, by whatever program; batch normalisation has PyTorch's numbers."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fixtures.convolutions import ANY_SHAPE, SHAPES, direct_conv
from flax import linen as nn
from hypothesis import given, settings
from hypothesis import strategies as st
from jax.sharding import NamedSharding, PartitionSpec

from ha2g_jax.layers.conv import BatchNorm, Conv, conv
from ha2g_jax.layers.cpu import convolution, winograd
from ha2g_jax.layers.cpu.convolution import kernel_gradient
from ha2g_jax.train import sharding


def arrays(height, width, inputs, channels, kernel, stride, padding, batch=2):
    """Return an input and the gradient of an output."""
    random = np.random.default_rng(0)
    x = random.normal(size=(batch, height, width, inputs)).astype(np.float32)
    size = [(edge + 2 * padding - k) // s + 1 for edge, k, s in zip((height, width), kernel, stride, strict=True)]
    return jnp.asarray(x), jnp.asarray(random.normal(size=(batch, *size, channels)).astype(np.float32))


def expected(x, cotangent, kernel, stride, padding):
    """Return XLA's gradient of a kernel."""
    zeros = jnp.zeros((*kernel, x.shape[-1], cotangent.shape[-1]))
    return jax.vjp(lambda kernel: convolution._native(x, kernel, stride, padding), zeros)[1](cotangent)[0]


def assert_equal(found, true, tolerance=1e-5):
    assert found.shape == true.shape
    np.testing.assert_allclose(found, true, rtol=0, atol=tolerance * np.abs(true).max())


@pytest.mark.parametrize(("shape", "devices"), [*((shape, 1) for shape in SHAPES), (SHAPES[0], 8)], ids=str)
def test_gradient_of_each_shape_of_the_networks(shape, devices, monkeypatch):
    """The number of devices decides how many images are in one product."""
    monkeypatch.setattr(jax, "device_count", lambda: devices)
    x, cotangent = arrays(*shape)
    *_, kernel, stride, padding = shape
    assert_equal(
        kernel_gradient(x, cotangent, size=kernel, stride=stride, padding=padding), expected(x, cotangent, *shape[4:])
    )


@settings(max_examples=8, deadline=None)
@given(**ANY_SHAPE)
def test_gradient_of_any_shape(batch, edges, values, kernel, stride, padding):
    x, cotangent = arrays(edges[0], edges[1], values[0], values[1], kernel, stride, padding, batch)
    zeros = jnp.zeros((*kernel, *values))
    ours = functools.partial(kernel_gradient, size=kernel, stride=stride, padding=padding)
    assert_equal(
        jax.jit(ours)(x, cotangent),
        jax.jit(lambda zeros: jax.vjp(lambda it: direct_conv(x, it, stride, padding), zeros)[1](cotangent)[0])(zeros),
    )


@pytest.fixture
def by_products(monkeypatch):
    """Let `conv` use the products for small arrays too."""
    monkeypatch.setattr(convolution, "is_faster_with_products", lambda *_: True)


def loss(function, x, kernel):
    return jnp.sum(jnp.tanh(function(jnp.sin(x), kernel)))


@pytest.fixture
def by_winograd(monkeypatch):
    """Let `conv` use Winograd's convolution for small arrays too."""
    monkeypatch.setattr(convolution, "is_faster_with_winograd", lambda *_: True)


@pytest.mark.parametrize(("program", "stride"), [("by_products", (2, 1)), ("by_winograd", (1, 1))])
def test_first_and_second_derivatives_are_those_of_xla(program, stride, request):
    request.getfixturevalue(program)
    random = np.random.default_rng(0)
    x, kernel = (random.normal(size=size).astype(np.float32) for size in ((3, 6, 5, 2), (3, 3, 2, 4)))

    def derivatives(function):
        first = jax.grad(functools.partial(loss, function), argnums=(0, 1))
        second = jax.grad(lambda *args: sum(jnp.sum(jnp.square(leaf)) for leaf in first(*args)), argnums=(0, 1))
        return jax.jit(first)(x, kernel), jax.jit(second)(x, kernel)

    ours = derivatives(lambda x, kernel: conv(x, kernel, stride, 1))
    xla = derivatives(lambda x, kernel: convolution._native(x, kernel, stride, 1))
    jax.tree.map(assert_equal, ours, xla)


# Height, width and inputs of the map, channels and padding of convolutions of the networks at the size of the paper.
WINOGRAD_SHAPES = [
    (128, 70, 32, 32, 1),
    (64, 35, 64, 64, 1),
    (16, 9, 256, 256, 1),
    (64, 36, 32, 32, 0),  # head
    (7, 7, 64, 64, 1),  # E_ID
]


def native(x, kernel, cotangent, padding):
    """Return XLA's convolution and the gradient of its kernel."""
    out, transpose = jax.vjp(lambda kernel: convolution._native(x, kernel, (1, 1), padding), kernel)
    return out, *transpose(cotangent)


def check_winograd(height, width, inputs, channels, padding, batch=2):
    """Compare with direct convolutions in float64: in float32 those of XLA err by up to 2e-5."""
    x, cotangent = arrays(height, width, inputs, channels, (3, 3), (1, 1), padding, batch)
    kernel = jnp.asarray(np.random.default_rng(1).normal(size=(3, 3, inputs, channels)), jnp.float32)
    with jax.enable_x64(True):
        exact = [jnp.asarray(array, jnp.float64) for array in (x, kernel, cotangent)]
        out, gradient = map(np.asarray, jax.jit(native, static_argnums=3)(*exact, padding))
    assert_equal(jax.jit(winograd.conv, static_argnums=2)(x, kernel, padding), out, 3e-6)
    assert_equal(jax.jit(winograd.kernel_gradient, static_argnums=2)(x, cotangent, padding), gradient, 3e-6)


@pytest.mark.parametrize("shape", WINOGRAD_SHAPES, ids=str)
def test_winograd_of_each_shape_of_the_networks(shape):
    check_winograd(*shape)


@settings(max_examples=4, deadline=None)
@given(
    batch=st.integers(1, 9),
    edges=st.tuples(st.integers(3, 12), st.integers(3, 12)),
    values=st.tuples(st.integers(1, 5), st.integers(1, 5)),
    padding=st.integers(0, 2),
)
def test_winograd_of_any_shape(batch, edges, values, padding):
    (height, width), (inputs, channels) = edges, values
    check_winograd(height, width, inputs, channels, padding, batch)


@pytest.mark.parametrize(
    ("program", "is_gradient"),
    [
        (functools.partial(kernel_gradient, size=(3, 3), stride=(1, 1), padding=1), True),
        (functools.partial(winograd.kernel_gradient, padding=1), True),
        (functools.partial(winograd.conv, padding=1), False),
    ],
    ids=["gradient by products", "gradient by Winograd", "Winograd"],
)
def test_a_batch_over_eight_devices_gives_the_values_of_one_and_is_not_gathered(program, is_gradient):
    x, cotangent = arrays(8, 6, 3, 4, (3, 3), (1, 1), 1, batch=16)
    kernel = jnp.asarray(np.random.default_rng(1).normal(size=(3, 3, 3, 4)), jnp.float32)
    mesh = sharding.data_mesh()
    split, whole = NamedSharding(mesh, PartitionSpec(sharding.AXIS)), NamedSharding(mesh, PartitionSpec())
    places, out = ((split, split), whole) if is_gradient else ((split, whole), split)
    arguments = (x, cotangent if is_gradient else kernel)
    run = jax.jit(program, in_shardings=places, out_shardings=out)
    assert_equal(run(*arguments), program(*arguments))
    assert "all-gather" not in (run.lower(*arguments).compile().as_text() or "")


def test_parameters_and_results_are_those_of_flax():
    x = np.random.default_rng(0).normal(size=(2, 9, 7, 3)).astype(np.float32)
    ours = Conv(4, (3, 2), (2, 1), 1)
    theirs = nn.Conv(4, (3, 2), (2, 1), ((1, 1), (1, 1)))
    variables = ours.init(jax.random.key(0), x)
    assert jax.tree.map(jnp.shape, variables) == jax.tree.map(jnp.shape, theirs.init(jax.random.key(0), x))
    np.testing.assert_array_equal(ours.apply(variables, x), theirs.apply(variables, x))


def _random(shape):
    return (2 + 3 * np.random.default_rng(0).normal(size=shape)).astype(np.float32)


def test_training_normalises_by_the_biased_and_keeps_the_unbiased_variance(oracles):
    x = _random((4, 5, 3))
    variables = BatchNorm().init(jax.random.key(0), x, train=True)
    np.testing.assert_array_equal(variables["batch_stats"]["mean"], np.zeros(3))
    y, updates = BatchNorm().apply(variables, x, train=True, mutable=["batch_stats"])
    mean, variance = x.mean((0, 1)), x.var((0, 1))
    oracles.assert_close(y, (x - mean) / np.sqrt(variance + 1e-5))
    oracles.assert_close(updates["batch_stats"]["mean"], 0.1 * mean)
    oracles.assert_close(updates["batch_stats"]["variance"], 0.9 + 0.1 * x.var((0, 1), ddof=1))


@pytest.mark.torch
@pytest.mark.parametrize("train", [True, False])
def test_equals_pytorch(train, oracles):
    torch = pytest.importorskip("torch")
    torch.manual_seed(0)
    theirs = torch.nn.BatchNorm2d(3).train(train)
    oracles.shake(torch, theirs)
    oracles.check(
        torch,
        BatchNorm(),
        lambda of: oracles.norm(theirs, of),
        theirs,
        torch.tensor(_random((4, 3, 5, 2))),
        lambda: oracles.statistics(theirs),
        train=train,
    )
