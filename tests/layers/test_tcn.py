"""The text encoder has the stated receptive field; tests/checkpoint/released compares its numbers with PyTorch's."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ha2g_jax.layers.tcn import TextEncoder, WeightNormConv

FRAMES = 64


def _encoder(receptive_field):
    return TextEncoder(
        vocabulary_size=5, embedding_dim=6, channels=6, layers=4, feature_dim=3, receptive_field=receptive_field
    )


@pytest.mark.parametrize(("receptive_field", "seen"), [("centred", range(-8, 8)), ("causal", range(-30, 1))])
def test_sees_16_centred_words_or_31_past_words(receptive_field, seen):
    # With positive weights no ReLU hides a word.
    encoder = _encoder(receptive_field)
    words = jnp.zeros(FRAMES, jnp.int32)
    variables = jax.jit(lambda key: encoder.init(key, words[None], train=False))(jax.random.key(0))
    variables = jax.tree.map(jnp.abs, variables)
    table = variables["params"]["embedding"]["embedding"]
    frame = FRAMES // 2

    def output(words):
        return jnp.asarray(encoder.apply(variables, words[None], train=False))[0, frame]

    assert not np.allclose(table[0], table[1])
    # One row per changed word, and a last row in which none is.
    outputs = np.asarray(jax.jit(jax.vmap(lambda at: output(words.at[at].set(1))))(jnp.arange(FRAMES + 1)))
    influences = np.any(outputs[:-1] != outputs[-1:], axis=-1)
    assert np.flatnonzero(influences).tolist() == [frame + offset for offset in seen]


def test_convolution_equals_its_definition(oracles):
    rng = np.random.default_rng(0)
    x, kernel = rng.normal(size=(1, 6, 2)), rng.normal(size=(2, 2, 3))
    scale, bias = rng.uniform(0.5, 2, size=3), rng.normal(size=3)
    weight = scale * kernel / np.sqrt((kernel**2).sum((0, 1)))
    padded = np.concatenate([np.zeros((2, 2)), x[0], np.zeros((1, 2))])
    expected = [padded[frame] @ weight[0] + padded[frame + 3] @ weight[1] + bias for frame in range(6)]

    params = {"kernel": kernel, "scale": scale, "bias": bias}
    variables = {"params": jax.tree.map(np.float32, params)}
    y = WeightNormConv(channels=3, dilation=3, padding=(2, 1)).apply(variables, x.astype(np.float32))
    oracles.assert_close(y[0], np.stack(expected))


def test_weight_normalisation_starts_as_the_identity(oracles):
    conv = WeightNormConv(channels=3, dilation=1, padding=(1, 0))
    params = conv.init(jax.random.key(0), jnp.zeros((1, 4, 2)))["params"]
    oracles.assert_close(params["scale"], np.sqrt((np.asarray(params["kernel"]) ** 2).sum((0, 1))))
