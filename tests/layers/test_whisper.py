"""Whisper's encoder equals other implementations; its features are those of the frames."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.special

from ha2g_jax.features.spectrum import asr_columns
from ha2g_jax.layers.resnet_se import Features
from ha2g_jax.layers.whisper import AsrAudioEncoder, EncoderBlock, WhisperEncoder, feature_blocks, resample, sinusoids

SMALL: dict[str, Any] = {"num_mels": 5, "d_model": 12, "layers": 3, "heads": 3, "ffn_dim": 20}


def encode(encoder, params, mel) -> Any:
    return jax.jit(encoder.apply)({"params": params}, mel)


def random_like(shapes, seed=0):
    rng = np.random.default_rng(seed)
    return jax.tree.map(lambda leaf: rng.normal(0, 0.5, leaf.shape).astype(np.float32), shapes)


def gelu(x):
    return x * (1 + scipy.special.erf(x / np.sqrt(2))) / 2


def norm(params, x):
    centred = x - x.mean(-1, keepdims=True)
    return centred / np.sqrt(x.var(-1, keepdims=True) + 1e-5) * params["scale"] + params["bias"]


def dense(params, x):
    return x @ params["kernel"] + params.get("bias", 0)


def block_by_hand(params, x, heads):
    """Apply a pre-norm block to x (positions, channels), head by head."""
    normed = norm(params["attention_norm"], x)
    query, key, value = (dense(params["attention"][name], normed) for name in ("query", "key", "value"))
    mixed = []
    for channels in np.split(np.arange(x.shape[1]), heads):
        scores = query[:, channels] @ key[:, channels].T / np.sqrt(len(channels))
        mixed.append(scipy.special.softmax(scores, axis=1) @ value[:, channels])
    x = x + dense(params["attention"]["out"], np.concatenate(mixed, axis=1))
    return x + dense(params["contract"], gelu(dense(params["expand"], norm(params["mlp_norm"], x))))


def convolve_by_hand(params, x, stride):
    padded = np.pad(x, ((1, 1), (0, 0)))
    taps = [padded[tap : tap + len(x) : stride] @ params["kernel"][tap] for tap in range(3)]
    return sum(taps) + params["bias"]


def test_a_block_equals_its_definition(oracles):
    block = EncoderBlock(heads=3, ffn_dim=20)
    x = np.random.default_rng(1).normal(size=(2, 7, 12)).astype(np.float32)
    params = random_like(jax.eval_shape(lambda: block.init(jax.random.key(0), x)))["params"]
    assert "bias" not in params["attention"]["key"]
    expected = np.stack([block_by_hand(params, clip.astype(np.float64), 3) for clip in x])
    oracles.assert_close(jax.jit(block.apply)({"params": params}, x), expected)


def test_the_encoder_equals_its_definition(oracles):
    """Both convolutions, the positions, each block's sum, and the norm of the last one only."""
    encoder = WhisperEncoder(**SMALL)
    mel = np.random.default_rng(1).normal(size=(2, 5, 16)).astype(np.float32)
    params = random_like(jax.eval_shape(lambda: encoder.init(jax.random.key(0), mel)))["params"]
    ours = encode(encoder, params, mel)
    assert len(ours) == 3 and ours[0].shape == (2, 8, 12)
    for clip in range(2):
        x = gelu(convolve_by_hand(params["conv_1"], mel[clip].T.astype(np.float64), 1))
        x = gelu(convolve_by_hand(params["conv_2"], x, 2)) + sinusoids(8, 12)
        expected = []
        for index in range(3):
            expected.append(x := block_by_hand(params[f"block_{index}"], x, 3))
        expected[-1] = norm(params["norm"], x)
        oracles.assert_close([level[clip] for level in ours], expected)


def test_positions_equal_their_definition():
    positions = sinusoids(7, 6)
    for place, pair in np.ndindex(7, 3):
        angle = place * 10000 ** (-pair / 2)
        np.testing.assert_allclose(positions[place, [pair, pair + 3]], [np.sin(angle), np.cos(angle)], atol=1e-6)


def test_half_precision_stays_half():
    encoder = WhisperEncoder(**SMALL)
    mel = np.random.default_rng(1).normal(size=(1, 5, 16)).astype(np.float32)
    params = random_like(jax.eval_shape(lambda: encoder.init(jax.random.key(0), mel)))["params"]
    exact = encode(encoder, params, mel)[-1]
    rounded = encode(encoder, jax.tree.map(lambda x: x.astype(jnp.bfloat16), params), mel.astype(jnp.bfloat16))
    assert {level.dtype for level in rounded} == {jnp.dtype(jnp.bfloat16)}
    assert np.linalg.norm(rounded[-1].astype(jnp.float32) - exact) < 0.05 * np.linalg.norm(exact)


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
    features = jax.jit(functools.partial(AsrAudioEncoder(WHISPER, feature_dim=5).apply, train=True))(variables, mel)
    assert isinstance(features, Features) and AsrAudioEncoder.inputs == ("asr_mel",)
    assert set(variables) == {"params"}
    blocks = encode(WHISPER, variables["params"]["whisper"], mel)
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


def test_whisper_is_frozen_and_its_maps_learn(mel, variables):
    def loss(params):
        features: Any = AsrAudioEncoder(WHISPER, feature_dim=5).apply({"params": params}, mel, train=True)
        return sum(jnp.mean(jnp.square(level - 1)) for level in features)

    gradient = jax.jit(jax.grad(loss))(variables["params"])
    assert not any(np.any(leaf) for leaf in jax.tree.leaves(gradient["whisper"]))
    assert all(np.any(gradient[name]["kernel"]) for name in Features._fields)
