"""Trimodal: the inputs of each frame, layers that equal PyTorch's, and a second run in other styles."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ha2g_jax.layers.identity import SpeakerIdentity
from ha2g_jax.layers.tcn import TextEncoder
from ha2g_jax.layers.waveform import WaveformEncoder
from ha2g_jax.methods import trimodal
from ha2g_jax.methods.trimodal import Trimodal
from ha2g_jax.train.step import step_keys


@pytest.fixture(scope="module")
def objective(make_objective):
    return make_objective("trimodal")


@pytest.fixture(scope="module")
def state(objective, draw_state):
    return draw_state(objective)


def keys_of(spec, number):
    return step_keys(spec, jax.random.key(number), jnp.int32(0))


def test_evaluation_compares_with_the_mean_styles_of_a_permutation(objective, state, make_motion_batch):
    batch = make_motion_batch(objective, 5)
    batch["speaker"] = jnp.arange(5)
    evaluate = jax.jit(
        lambda batch, keys: trimodal.run(objective.spec, state.generator.variables, batch, keys, train=False)
    )
    outputs, contrast, _ = evaluate(batch, keys_of(objective.spec, 0))
    np.testing.assert_array_equal(contrast.z, outputs.mean)
    order = [
        int(np.argmin(np.abs(np.asarray(outputs.mean) - row).max(axis=-1))) for row in np.asarray(contrast.other_z)
    ]
    np.testing.assert_array_equal(contrast.other_z, outputs.mean[np.array(order)])
    assert sorted(order) == list(range(5)) != order
    other = evaluate(batch | {"speaker": jnp.array(order)}, keys_of(objective.spec, 1))
    np.testing.assert_allclose(contrast.poses, other.outputs.poses[-1], atol=1e-6)
    assert not np.allclose(contrast.poses, outputs.poses[-1], atol=1e-6)


def test_training_samples_both_styles(objective, state, make_motion_batch):
    """Even a clip that keeps its speaker, such as that of a batch of one, gets another style."""
    batch, keys = make_motion_batch(objective, 1), keys_of(objective.spec, 0)
    outputs, contrast, _ = jax.jit(
        lambda: trimodal.run(objective.spec, state.generator.variables, batch, keys, train=True)
    )()
    assert len({tuple(np.asarray(z[0])) for z in (outputs.mean, contrast.z, contrast.other_z)}) == 3


FRAMES, SEEDS = 34, 4


def test_without_words_the_features_are_those_of_the_sound(make_objective):
    spec = make_objective("trimodal", model__text__kind="none").spec
    assert spec.inputs == ("audio",) and spec.generator.text is None
    encode = functools.partial(spec.generator.init_with_output, train=False, method=Trimodal.encode_speech)
    features, _ = jax.eval_shape(encode, jax.random.key(0), {"audio": jnp.zeros((2, 36_267))})
    assert features.shape[:2] == (2, FRAMES)


@pytest.mark.torch
def test_inference_equals_pytorch(oracles):
    """The input of each frame is [seed or 0 ; seed bit ; speech ; style]."""
    torch = pytest.importorskip("torch")
    torch.manual_seed(0)
    nn = torch.nn
    gru = nn.GRU(6 + 1 + 5 + 2, 8, num_layers=2, bidirectional=True, batch_first=True)
    linears = [nn.Linear(8, 4), nn.Linear(4, 6)]
    features, style, seed = torch.randn(3, FRAMES, 5), torch.randn(3, 2), torch.randn(3, SEEDS, 6)
    known = torch.zeros(3, FRAMES, 7)
    known[:, :SEEDS, :6], known[:, :SEEDS, 6] = seed, 1
    states, _ = gru(torch.cat([known, features, style[:, None].expand(-1, FRAMES, -1)], dim=-1))
    hidden = nn.functional.leaky_relu(linears[0](states[..., :8] + states[..., 8:]), 0.01)
    out = linears[1](hidden)

    params = {f"linear_{index}": oracles.dense(layer) for index, layer in enumerate(linears, 1)}
    variables = {"params": {"decoder": params | {"gru": oracles.gru(gru)}}}
    text = TextEncoder(5, embedding_dim=4, channels=4, layers=1, feature_dim=3, receptive_field="causal")
    audio, identity = WaveformEncoder(feature_dim=3), SpeakerIdentity(3, feature_dim=2, has_hidden=True)
    ours = Trimodal(audio, text, identity, pose_dim=6, hidden_dim=8, layers=2, dropout=0.0)
    run = jax.jit(lambda *args: ours.apply(variables, *args, train=False, method=Trimodal.infer))
    (poses,) = run(*(oracles.value(array) for array in (features, style, seed)))
    oracles.assert_close(poses, oracles.value(out))


def test_speakers_pass_a_linear_map_before_the_heads(oracles):
    encoder = SpeakerIdentity(3, feature_dim=4, has_hidden=True)
    variables = jax.jit(lambda key: encoder.init(key, jnp.zeros(1, jnp.int32), train=False))(jax.random.key(0))
    params = jax.tree.map(np.asarray, variables["params"])
    x = params["embedding"]["embedding"][[2, 0]]
    for name in ("linear", "mean"):
        x = x @ params[name]["kernel"] + params[name]["bias"]
    mean, log_variance = map(np.asarray, encoder.apply(variables, jnp.array([2, 0]), train=False))
    assert log_variance.shape == (2, 4)
    oracles.assert_close(mean, x)
