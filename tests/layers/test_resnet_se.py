"""The audio encoder has the shapes of Tables 6 and 7 and PyTorch's numbers."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ha2g_jax.layers.resnet_se import AudioEncoder, BasicBlock, SqueezeExcite, pixel_shuffle

SMALL = {"blocks": (1, 1, 1, 1), "channels": (8, 8, 16, 32), "stem_stride": (2, 1)}


def test_pixel_shuffle_follows_its_definition():
    x = np.arange(2 * 3 * 8).reshape(1, 2, 3, 8)
    y = np.asarray(pixel_shuffle(jnp.asarray(x), 2))
    assert y.shape == (1, 4, 6, 2)
    for row, column, channel in np.ndindex(4, 6, 2):
        assert y[0, row, column, channel] == x[0, row // 2, column // 2, channel * 4 + row % 2 * 2 + column % 2]
    # The first row of the first channel, worked out by hand.
    assert y[0, 0, :, 0].tolist() == [0, 1, 8, 9, 16, 17]
    assert y[0, 1, :, 0].tolist() == [2, 3, 10, 11, 18, 19]


def test_squeeze_excite_equals_its_definition(oracles):
    x = np.random.default_rng(0).normal(size=(2, 3, 4, 16)).astype(np.float32)
    variables = SqueezeExcite().init(jax.random.key(0), x)
    squeeze, excite = (jax.tree.map(np.asarray, variables["params"][name]) for name in ("squeeze", "excite"))
    hidden = np.maximum(x.mean((1, 2)) @ squeeze["kernel"] + squeeze["bias"], 0)
    assert hidden.shape == (2, 2)
    gate = 1 / (1 + np.exp(-(hidden @ excite["kernel"] + excite["bias"])))
    oracles.assert_close(SqueezeExcite().apply(variables, x), x * gate[:, None, None])


@pytest.mark.parametrize("sizes", [{}, SMALL, SMALL | {"channels": (16, 32, 64, 128)}])
def test_70_columns_give_34_frames_at_each_level(sizes):
    """With as many parameters as the release at the size of the paper."""
    encoder = AudioEncoder(**sizes)
    features, variables = jax.eval_shape(
        lambda key: encoder.init_with_output(key, jnp.zeros((2, 128, 70)), train=False), jax.random.key(0)
    )
    assert [level.shape for level in features] == [(2, 34, 32)] * 3
    assert sizes or sum(leaf.size for leaf in jax.tree.leaves(variables["params"])) == 5_656_700


def test_other_columns_are_refused():
    with pytest.raises(ValueError, match=r"72 columns.*expected 70"):
        jax.eval_shape(
            lambda key: AudioEncoder(**SMALL).init(key, jnp.zeros((1, 128, 72)), train=False), jax.random.key(0)
        )


@pytest.mark.torch
@pytest.mark.parametrize("train", [True, False])
def test_basic_block_equals_pytorch_in_values_and_gradients(train, oracles):
    torch = pytest.importorskip("torch")
    torch.manual_seed(0)
    from fixtures.released_torch import Block

    theirs = Block(4, 16, 2).train(train)
    oracles.shake(torch, theirs)

    convs = {"conv_1": theirs.conv1, "conv_2": theirs.conv2, "shortcut_conv": theirs.downsample[0]}
    norms = {"norm_1": theirs.bn1, "norm_2": theirs.bn2, "shortcut_norm": theirs.downsample[1]}
    gate = {"squeeze": theirs.se.fc[0], "excite": theirs.se.fc[2]}

    def read(of):
        params = {name: oracles.conv(layer, of) for name, layer in convs.items()}
        params |= {name: oracles.norm(layer, of) for name, layer in norms.items()}
        return params | {"se": {name: oracles.dense(layer, of) for name, layer in gate.items()}}

    def statistics():
        return {name: oracles.statistics(layer) for name, layer in norms.items()}

    module, x = BasicBlock(channels=16, stride=2), torch.randn(3, 4, 9, 7)
    oracles.check(torch, module, read, theirs, x, statistics, train=train)
