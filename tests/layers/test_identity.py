"""Identity encoders: the ResNet-18 equals PyTorch's layers, and the order of the M images has no effect."""

import jax
import numpy as np
import pytest

from ha2g_jax.layers.identity import ImageIdentity, ResNet


def test_frames_are_averaged_whatever_their_order(oracles):
    frames = np.random.default_rng(0).integers(0, 256, (2, 3, 40, 40, 3), np.uint8)
    encoder = ImageIdentity(width=4)
    variables = jax.jit(lambda: encoder.init(jax.random.key(0), frames, train=False))()
    run = jax.jit(lambda frames: encoder.apply(variables, frames, train=False))
    mean, log_variance = run(frames)
    assert mean.shape == log_variance.shape == (2, 18)
    oracles.assert_close(run(frames[:, ::-1]), (mean, log_variance))
    single = [run(frames[:, [index]])[0] for index in range(3)]
    oracles.assert_close(mean, np.mean(single, axis=0))
    assert not np.allclose(mean[0], mean[1])


def _resnet18(torch, width):
    """The network of He et al. 2016 up to its last stage, written for this test."""
    nn = torch.nn
    layers = {"conv": nn.Conv2d(3, width, 7, 2, 3, bias=False), "norm": nn.BatchNorm2d(width)}
    inputs = width
    for stage in range(4):
        channels = width * 2**stage
        for index in range(2):
            stride = 2 if stage and not index else 1
            block = {
                "conv_1": nn.Conv2d(inputs, channels, 3, stride, 1, bias=False),
                "norm_1": nn.BatchNorm2d(channels),
                "conv_2": nn.Conv2d(channels, channels, 3, 1, 1, bias=False),
                "norm_2": nn.BatchNorm2d(channels),
            }
            if inputs != channels:
                block["shortcut_conv"] = nn.Conv2d(inputs, channels, 1, stride, bias=False)
                block["shortcut_norm"] = nn.BatchNorm2d(channels)
            layers[f"stage_{stage + 1}_block_{index}"] = nn.ModuleDict(block)
            inputs = channels
    return nn.ModuleDict(layers)


def _run_resnet18(torch, layers, x):
    x = torch.relu(layers["norm"](layers["conv"](x)))
    x = torch.nn.functional.max_pool2d(x, 3, 2, 1)
    for name, block in layers.items():
        if name.startswith("stage"):
            y = torch.relu(block["norm_1"](block["conv_1"](x)))
            y = block["norm_2"](block["conv_2"](y))
            if "shortcut_conv" in block:
                x = block["shortcut_norm"](block["shortcut_conv"](x))
            x = torch.relu(x + y)
    return x


def _read(layers, read_conv, read_norm):
    tree = {}
    for name, layer in layers.items():
        if name.startswith("stage"):
            tree[name] = _read(layer, read_conv, read_norm)
        elif "conv" in name and read_conv:
            tree[name] = read_conv(layer)
        elif "norm" in name:
            tree[name] = read_norm(layer)
    return tree


@pytest.mark.torch
@pytest.mark.parametrize("train", [True, False])
def test_resnet18_equals_pytorch_in_values_and_gradients(train, oracles):
    torch = pytest.importorskip("torch")
    torch.manual_seed(0)
    theirs = _resnet18(torch, width=4).train(train)
    oracles.shake(torch, theirs)

    def read(of):
        return _read(theirs, lambda layer: oracles.conv(layer, of), lambda layer: oracles.norm(layer, of))

    oracles.check(
        torch,
        ResNet(width=4),
        read,
        lambda x: _run_resnet18(torch, theirs, x),
        torch.randn(3, 3, 70, 70),
        lambda: _read(theirs, None, oracles.statistics),
        train=train,
        tolerance=3e-5,  # 17 layers of float32 lie between
    )
