"""Reads PyTorch layers into the layouts of our modules, values or gradients, and compares arrays."""

import sys
import types

import jax
import numpy as np
import pytest


@pytest.fixture(scope="session")
def oracles() -> types.ModuleType:
    """The functions of this file."""
    return sys.modules[__name__]


def value(tensor) -> np.ndarray:
    return tensor.detach().numpy().copy()


def gradient(tensor) -> np.ndarray:
    return tensor.grad.numpy().copy()


def conv(layer, read=value) -> dict[str, np.ndarray]:
    """(out, in, *space) to (*space, in, out)."""
    kernel = {"kernel": np.moveaxis(read(layer.weight), (0, 1), (-1, -2))}
    return kernel if layer.bias is None else kernel | {"bias": read(layer.bias)}


def transposed_conv(layer, read=value) -> dict[str, np.ndarray]:
    """(in, out, space) to (space, in, out), flipped: PyTorch's is the gradient of a correlation."""
    return {"kernel": np.moveaxis(read(layer.weight), 2, 0)[::-1].copy(), "bias": read(layer.bias)}


def dense(layer, read=value) -> dict[str, np.ndarray]:
    return {"kernel": read(layer.weight).T.copy(), "bias": read(layer.bias)}


def norm(layer, read=value) -> dict[str, np.ndarray]:
    return {"scale": read(layer.weight), "bias": read(layer.bias)}


def statistics(layer) -> dict[str, np.ndarray]:
    return {"mean": value(layer.running_mean), "variance": value(layer.running_var)}


def gru(layer, read=value) -> dict[str, np.ndarray]:
    return {name: read(parameter) for name, parameter in layer.named_parameters()}


def shake(torch, module) -> None:
    """Gives every parameter and running statistic of a PyTorch module a value of no special kind."""
    with torch.no_grad():
        for name, tensor in [*module.named_parameters(), *module.named_buffers()]:
            if name.endswith("running_var"):
                tensor.uniform_(0.5, 2)
            elif tensor.is_floating_point() and tensor.ndim == 1:
                tensor.add_(0.3 * torch.randn_like(tensor))


def assert_close(ours, theirs, tolerance: float = 1e-5) -> None:
    """Trees of equal structure whose leaves differ by at most `tolerance` times the leaf's largest value."""
    assert jax.tree.structure(ours) == jax.tree.structure(theirs)
    for (path, a), b in zip(jax.tree.leaves_with_path(ours), jax.tree.leaves(theirs), strict=True):
        scale = max(float(np.max(np.abs(b))), 1e-3)
        np.testing.assert_allclose(a, b, rtol=0, atol=tolerance * scale, err_msg=jax.tree_util.keystr(path))
