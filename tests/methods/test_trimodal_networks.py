"""Trimodal has the sizes of its table, the right inputs at each frame, and equals PyTorch's layers."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ha2g_jax.config import presets
from ha2g_jax.layers.identity import SpeakerIdentity
from ha2g_jax.layers.tcn import TextEncoder
from ha2g_jax.layers.waveform import WaveformEncoder
from ha2g_jax.methods import trimodal
from ha2g_jax.methods.trimodal import Trimodal
from ha2g_jax.skeleton import load_skeleton

FRAMES, SEEDS = 34, 4


def arguments(pose_dim, batch=2):
    speech = {"audio": jnp.zeros((batch, 36_267)), "words": jnp.zeros((batch, FRAMES), jnp.int32)}
    return speech, jnp.arange(batch), jnp.zeros((batch, SEEDS, pose_dim))


def small(pose_dim=6, layers=1):
    text = TextEncoder(5, embedding_dim=4, channels=4, layers=1, feature_dim=3, receptive_field="causal")
    audio, identity = WaveformEncoder(feature_dim=3), SpeakerIdentity(3, feature_dim=2, has_hidden=True)
    return Trimodal(audio, text, identity, pose_dim, hidden_dim=8, layers=layers, dropout=0.0)


@pytest.mark.parametrize(("pose_dim", "count"), [(27, 7_183_003), (126, 7_376_152)])
def test_has_as_many_parameters_as_the_original(pose_dim, count):
    identity = SpeakerIdentity(3, feature_dim=16, has_hidden=True)
    model = Trimodal(WaveformEncoder(), TextEncoder(9, receptive_field="causal"), identity, pose_dim)
    shapes = jax.eval_shape(lambda key: model.init(key, *arguments(pose_dim), train=False), jax.random.key(0))
    for part, rows in (("text", 9), ("identity", 3)):
        assert shapes["params"][part].pop("embedding")["embedding"].shape[0] == rows
    assert sum(leaf.size for leaf in jax.tree.leaves(shapes["params"])) == count
    assert model.identity.feature_dim == 16


@pytest.mark.parametrize("batch", [1, 3])
def test_shapes_of_features_and_poses(batch):
    model = small()
    speech, speaker, seed = arguments(6, batch)

    def run(key):
        variables = model.init(key, speech, speaker, seed, train=False)
        features = model.apply(variables, speech, train=False, method=Trimodal.encode_speech)
        style, _ = model.apply(variables, speaker, train=False, method=Trimodal.encode_identity)
        return features, style, model.apply(variables, features, style, seed, train=False, method=Trimodal.infer)

    features, style, (poses,) = jax.eval_shape(run, jax.random.key(0))
    assert (features.shape, style.shape, poses.shape) == ((batch, FRAMES, 6), (batch, 2), (batch, FRAMES, 6))


def test_without_words_the_features_are_those_of_the_sound():
    config = presets.make("talk", "debug", "trimodal", {"model.text.kind": "none"})
    spec = trimodal.build(config, load_skeleton("ted_expressive"), vocabulary_size=5, num_speakers=3)
    assert spec.inputs == ("audio",) and spec.generator.text is None
    speech, speaker, seed = arguments(126)
    del speech["words"]

    def run(key):
        variables = spec.generator.init(key, speech, speaker, seed, train=False)
        return spec.generator.apply(variables, speech, train=False, method=Trimodal.encode_speech)

    features = jax.eval_shape(run, jax.random.key(0))
    assert features.shape == (2, FRAMES, config.model.audio.feature_dim)


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
    run = jax.jit(lambda *args: small(layers=2).apply(variables, *args, train=False, method=Trimodal.infer))
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
