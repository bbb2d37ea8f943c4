"""Batch normalisation has PyTorch's numbers, and is global when the batch is split over devices."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ha2g_jax.layers.conv import BatchNorm


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


def test_evaluation_uses_the_running_statistics(oracles):
    x = _random((2, 3))
    mean, variance = np.array([1.0, 2, 3], np.float32), np.array([4.0, 1, 9], np.float32)
    variables = {
        "params": {"scale": np.full(3, 2, np.float32), "bias": np.full(3, 0.5, np.float32)},
        "batch_stats": {"mean": mean, "variance": variance},
    }
    y = BatchNorm().apply(variables, x, train=False)
    oracles.assert_close(y, 2 * (x - mean) / np.sqrt(variance + 1e-5) + 0.5)


def test_is_global_over_devices(oracles):
    x = _random((16, 3))
    variables = BatchNorm().init(jax.random.key(0), x, train=True)

    @jax.jit
    def run(x):
        return BatchNorm().apply(variables, x, train=True, mutable=["batch_stats"])

    mesh = jax.make_mesh((8,), ("data",), axis_types=(jax.sharding.AxisType.Auto,))
    split = jax.device_put(x, jax.NamedSharding(mesh, jax.P("data")))
    oracles.assert_close(jax.tree.map(np.asarray, run(split)), jax.tree.map(np.asarray, run(x)), 1e-6)


@pytest.mark.torch
@pytest.mark.parametrize("train", [True, False])
def test_equals_pytorch(train, oracles):
    torch = pytest.importorskip("torch")
    torch.manual_seed(0)
    theirs = torch.nn.BatchNorm2d(3).train(train)
    oracles.shake(torch, theirs)
    variables = {"params": oracles.norm(theirs), "batch_stats": oracles.statistics(theirs)}
    x = torch.tensor(_random((4, 3, 5, 2)), requires_grad=True)
    out = theirs(x)
    cotangent = torch.randn_like(out)
    out.backward(cotangent)

    def run(params, x):
        return BatchNorm().apply(variables | {"params": params}, x, train=train, mutable=["batch_stats"])

    last = (0, 2, 3, 1)
    y, pull_back, updates = jax.vjp(run, variables["params"], oracles.value(x).transpose(last), has_aux=True)
    oracles.assert_close(y, oracles.value(out).transpose(last))
    oracles.assert_close(
        pull_back(jnp.asarray(oracles.value(cotangent).transpose(last))),
        (oracles.norm(theirs, oracles.gradient), oracles.gradient(x).transpose(last)),
    )
    oracles.assert_close(updates["batch_stats"], oracles.statistics(theirs))
