"""The encoder of raw speech has the lengths and sizes of its table, and equals PyTorch's layers."""

import jax
import jax.numpy as jnp
import pytest

from ha2g_jax.layers.waveform import WaveformEncoder

SAMPLES = 36_267


def test_a_window_becomes_34_steps_and_the_parameters_are_those_of_the_table():
    encoder = WaveformEncoder()
    audio = jnp.zeros((2, SAMPLES))

    def run(key):
        variables = encoder.init(key, audio, train=False)
        _, state = encoder.apply(variables, audio, train=False, capture_intermediates=True, mutable=["intermediates"])
        return variables["params"], state["intermediates"]

    params, outputs = jax.eval_shape(run, jax.random.key(0))
    assert [outputs[f"conv_{index}"]["__call__"][0].shape for index in range(1, 5)] == [
        (2, 7891, 16),
        (2, 1313, 32),
        (2, 217, 64),
        (2, 34, 32),
    ]
    assert sum(leaf.size for leaf in jax.tree.leaves(params)) == 69_728


@pytest.mark.torch
@pytest.mark.parametrize("train", [True, False])
def test_equals_pytorch_in_values_and_gradients(train, oracles):
    torch = pytest.importorskip("torch")
    torch.manual_seed(0)
    from fixtures.released_torch import waveform_encoder

    theirs = waveform_encoder().train(train)
    oracles.shake(torch, theirs)
    convs, norms = [theirs[index] for index in (0, 3, 6, 9)], [theirs[index] for index in (1, 4, 7)]

    def read(read):
        params = {f"conv_{index}": oracles.conv(layer, read) for index, layer in enumerate(convs, 1)}
        return params | {f"norm_{index}": oracles.norm(layer, read) for index, layer in enumerate(norms, 1)}

    def statistics():
        return {f"norm_{index}": oracles.statistics(layer) for index, layer in enumerate(norms, 1)}

    params, before = read(oracles.value), statistics()
    audio = torch.randn(2, 1, SAMPLES)
    out = theirs(audio)
    assert out.shape == (2, 32, 34)
    cotangent = torch.randn_like(out)
    out.backward(cotangent)

    def run(params):
        variables = {"params": params, "batch_stats": before}
        return WaveformEncoder().apply(variables, oracles.value(audio)[:, 0], train=train, mutable=["batch_stats"])

    y, pull_back, updates = jax.vjp(jax.jit(run), params, has_aux=True)
    oracles.assert_close(y, oracles.value(out).transpose(0, 2, 1))
    oracles.assert_close(updates["batch_stats"], statistics())
    (gradients,) = pull_back(jnp.asarray(oracles.value(cotangent).transpose(0, 2, 1)))
    expected = read(oracles.gradient)
    if train:  # BatchNorm takes a bias before it away; what is left of its gradient is rounding
        for index in (1, 2, 3):
            for tree in (gradients, expected):
                del tree[f"conv_{index}"]["bias"]
    oracles.assert_close(gradients, expected, 3e-5)
