"""Features of a frozen Whisper encoder have the shapes of E_a and the right times, and only their maps are trained."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from ha2g_jax.features.spectrum import asr_columns
from ha2g_jax.layers.resnet_se import Features
from ha2g_jax.layers.whisper import AsrAudioEncoder, WhisperEncoder, feature_blocks, resample

WHISPER = WhisperEncoder(num_mels=6, d_model=8, layers=4, heads=2, ffn_dim=16)


@pytest.fixture(scope="module")
def mel():
    return jnp.asarray(np.random.default_rng(0).normal(size=(2, 6, asr_columns(34, 15))).astype(np.float32))


@pytest.fixture(scope="module")
def variables(mel):
    shapes = jax.eval_shape(lambda: AsrAudioEncoder(WHISPER, feature_dim=5).init(jax.random.key(0), mel, train=False))
    rng = np.random.default_rng(1)
    return jax.tree.map(lambda leaf: jnp.asarray(rng.normal(0, 0.3, leaf.shape).astype(np.float32)), shapes)


def test_levels_are_maps_of_three_blocks(mel, variables):
    features = AsrAudioEncoder(WHISPER, feature_dim=5).apply(variables, mel, train=True)
    assert isinstance(features, Features) and AsrAudioEncoder.inputs == ("asr_mel",)
    assert set(variables) == {"params"}
    blocks: Any = WHISPER.apply({"params": variables["params"]["whisper"]}, mel)
    for name, block in (("low", 0), ("mid", 1), ("high", 3)):
        linear = variables["params"][name]
        stream = np.asarray(blocks[block])
        stream = (stream - stream.mean(-1, keepdims=True)) / np.sqrt(stream.var(-1, keepdims=True) + 1e-5)
        expected = resample(jnp.asarray(stream), 34, 15) @ linear["kernel"] + linear["bias"][None, None]
        assert expected.shape == (2, 34, 5)
        np.testing.assert_allclose(getattr(features, name), expected, atol=1e-5)


@pytest.mark.parametrize(("layers", "blocks"), [(1, (0, 0, 0)), (2, (0, 0, 1)), (4, (0, 1, 3)), (6, (0, 2, 5))])
def test_an_early_a_middle_and_the_last_block(layers, blocks):
    assert feature_blocks(layers) == blocks


@pytest.mark.parametrize("fps", [15, 30])
def test_features_lie_at_the_middle_of_the_frames(fps):
    """Features that are equal to their own time are equal to that of the frame after resampling."""
    times = 0.02 * np.arange(114, dtype=np.float32)
    features = np.stack([times, -times], axis=1)[None].repeat(2, axis=0)
    middles = (np.arange(34) + 0.5) / fps
    expected = np.stack([middles, -middles], axis=1)[None].repeat(2, axis=0)
    np.testing.assert_allclose(resample(jnp.asarray(features), 34, fps), expected, atol=1e-6)


@pytest.mark.parametrize("fps", [15, 25, 30])
def test_every_position_of_the_window_counts_about_alike(fps):
    """Without the mean, what is fast is taken for something slow. The last positions lie in part past the window."""
    positions = asr_columns(34, fps) // 2
    weights = jax.jacobian(lambda x: resample(x[None, :, None], 34, fps)[0, :, 0])(jnp.zeros(positions))
    np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-6)
    inner = np.asarray(weights.sum(axis=0))[1 : int(50 * 34 / fps) - 1]
    assert inner.min() > 0.6 * inner.max()


def test_a_window_that_is_too_short_is_refused():
    with pytest.raises(ValueError, match=r"112 positions are 2.24 s.*34 frames at 15 fps, 2.27 s"):
        resample(jnp.zeros((1, 112, 3)), 34, 15)


def test_whisper_is_frozen_and_its_maps_learn(mel, variables):
    """Twenty steps of Adam come close to a target, and Whisper's parameters do not change."""
    encoder = AsrAudioEncoder(WHISPER, feature_dim=5)
    optimizer = optax.adam(3e-2)

    def loss(params):
        features: Any = encoder.apply({"params": params}, mel, train=True)
        return sum(jnp.mean(jnp.square(level - 1)) for level in features)

    @jax.jit
    def step(params, state):
        value, gradient = jax.value_and_grad(loss)(params)
        updates, state = optimizer.update(gradient, state, params)
        return optax.apply_updates(params, updates), state, value

    params, state, losses = variables["params"], optimizer.init(variables["params"]), []
    for _ in range(20):
        params, state, value = step(params, state)
        losses.append(float(value))
    assert losses[-1] < losses[0] / 2
    jax.tree.map(np.testing.assert_array_equal, params["whisper"], variables["params"]["whisper"])
    for name in Features._fields:
        assert np.any(params[name]["kernel"] != variables["params"][name]["kernel"])
