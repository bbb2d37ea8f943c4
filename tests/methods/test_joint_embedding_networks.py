"""Joint Embedding has the sizes of its table, decodes both latents, and its layers equal PyTorch's."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ha2g_jax.layers.tcn import TextEncoder
from ha2g_jax.layers.waveform import WaveformEncoder
from ha2g_jax.methods.joint_embedding import ContextEncoder, JointEmbedding

FRAMES, SEEDS = 34, 4


def arguments(pose_dim, batch=2):
    speech = {"audio": jnp.zeros((batch, 36_267)), "words": jnp.zeros((batch, FRAMES), jnp.int32)}
    return speech, None, jnp.zeros((batch, SEEDS, pose_dim))


def small(pose_dim=6):
    text = TextEncoder(5, embedding_dim=4, channels=4, layers=1, feature_dim=3, receptive_field="causal")
    audio = WaveformEncoder(feature_dim=3)
    return JointEmbedding(audio, text, pose_dim, context_dim=8, hidden_dim=8, layers=2, dropout=0.0)


@pytest.mark.parametrize(("pose_dim", "count"), [(27, 6_933_075), (126, 6_970_200)])
def test_has_as_many_parameters_as_the_original(pose_dim, count):
    text = TextEncoder(9, channels=200, layers=2, receptive_field="causal")
    model = JointEmbedding(WaveformEncoder(), text, pose_dim)
    shapes = jax.eval_shape(lambda key: model.init(key, *arguments(pose_dim), train=False), jax.random.key(0))
    assert shapes["params"]["text"].pop("embedding")["embedding"].shape[0] == 9
    assert sum(leaf.size for leaf in jax.tree.leaves(shapes["params"])) == count
    assert model.latent_dim == 32


@pytest.mark.parametrize("batch", [1, 3])
def test_a_pose_latent_can_take_the_place_of_a_speech_latent(batch):
    model = small()
    speech, _, seed = arguments(6, batch)

    def run(key):
        variables = model.init(key, speech, None, seed, train=False)
        features = model.apply(variables, speech, train=False, method=JointEmbedding.encode_speech)
        levels: Any = model.apply(
            variables, features, jnp.zeros((batch, 32)), seed, train=False, method=JointEmbedding.infer
        )
        (poses,) = levels
        latent, _ = model.apply(variables, poses, train=False, method=JointEmbedding.encode_pose)
        return features, poses, latent, model.apply(variables, latent, seed, train=False, method=JointEmbedding.decode)

    features, poses, latent, decoded = jax.eval_shape(run, jax.random.key(0))
    assert [array.shape for array in (*features, latent)] == [(batch, 32)] * 3
    assert poses.shape == decoded.shape == (batch, FRAMES, 6)


def test_style_is_the_noise_of_the_latent(oracles):
    model = small()
    speech, _, seed = arguments(6, 3)
    shapes = jax.eval_shape(lambda key: model.init(key, speech, None, seed, train=False), jax.random.key(0))
    rng = np.random.default_rng(0)  # compiling the initialisation takes long
    variables = {
        "params": jax.tree.map(lambda x: rng.normal(0, 0.3, x.shape).astype(np.float32), shapes["params"]),
        "batch_stats": jax.tree.map(lambda x: np.ones(x.shape, np.float32), shapes["batch_stats"]),
    }
    mean, log_variance, noise, other_noise = rng.normal(size=(4, 3, 32)).astype(np.float32)
    infer = jax.jit(
        lambda noise: model.apply(
            variables, (mean, log_variance), noise, seed, train=False, method=JointEmbedding.infer
        )
    )
    decode = jax.jit(lambda latent: model.apply(variables, latent, seed, train=False, method=JointEmbedding.decode))
    (poses,) = infer(noise)
    oracles.assert_close(poses, decode(mean + np.exp(0.5 * log_variance) * noise))
    assert not np.allclose(poses, infer(other_noise)[0])


@pytest.mark.torch
@pytest.mark.parametrize("train", [True, False])
def test_context_encoder_equals_pytorch(train, oracles):
    torch = pytest.importorskip("torch")
    torch.manual_seed(0)
    nn = torch.nn
    gru = nn.GRU(5, 8, num_layers=2, batch_first=True)
    linears = {"linear_1": nn.Linear(8, 4), "linear_2": nn.Linear(4, 3)}
    linears |= {"mean": nn.Linear(3, 3), "log_variance": nn.Linear(3, 3)}
    norm = nn.BatchNorm1d(4).train(train)
    oracles.shake(torch, norm)
    variables = {
        "params": {name: oracles.dense(layer) for name, layer in linears.items()}
        | {"norm": oracles.norm(norm), "gru": oracles.gru(gru)},
        "batch_stats": {"norm": oracles.statistics(norm)},
    }
    x = torch.randn(6, FRAMES, 5)
    states, _ = gru(x)
    hidden = linears["linear_2"](torch.relu(norm(linears["linear_1"](states[:, -1]))))
    expected = tuple(oracles.value(linears[name](hidden)) for name in ("mean", "log_variance"))

    run = jax.jit(lambda x: ContextEncoder(3, 8, 2).apply(variables, x, train=train, mutable=["batch_stats"]))
    features, updates = run(oracles.value(x))
    oracles.assert_close(features, expected)
    oracles.assert_close(updates["batch_stats"]["norm"], oracles.statistics(norm))
    # The GRU's own gradient, through the last step alone.
    (expected_gradient,) = torch.autograd.grad(linears["mean"](hidden).sum(), gru.weight_hh_l0)
    gradient = jax.grad(
        lambda params: jnp.sum(
            ContextEncoder(3, 8, 2).apply(
                variables | {"params": params}, oracles.value(x), train=train, mutable=["batch_stats"]
            )[0][0]
        )
    )(variables["params"])
    oracles.assert_close(gradient["gru"]["weight_hh_l0"], oracles.value(expected_gradient), 1e-4)


@pytest.mark.torch
def test_decoder_equals_pytorch(oracles):
    """Seed code and latent are repeated on all frames."""
    torch = pytest.importorskip("torch")
    torch.manual_seed(0)
    nn = torch.nn
    seed_linears, norm = [nn.Linear(SEEDS * 6, 32), nn.Linear(32, 32)], nn.BatchNorm1d(32).eval()
    gru = nn.GRU(64, 8, num_layers=2, bidirectional=True, batch_first=True)
    linears = [nn.Linear(8, 4), nn.Linear(4, 6)]
    oracles.shake(torch, norm)
    latent, seed = torch.randn(3, 32), torch.randn(3, SEEDS, 6)
    code = seed_linears[1](torch.relu(norm(seed_linears[0](seed.reshape(3, -1)))))
    states, _ = gru(torch.cat([code, latent], dim=-1)[:, None].expand(-1, FRAMES, -1))
    out = linears[1](nn.functional.leaky_relu(linears[0](states[..., :8] + states[..., 8:]), 0.01))

    seed_params = {f"linear_{index}": oracles.dense(layer) for index, layer in enumerate(seed_linears, 1)}
    params = {f"linear_{index}": oracles.dense(layer) for index, layer in enumerate(linears, 1)}
    variables = {
        "params": {
            "seed_encoder": seed_params | {"norm": oracles.norm(norm)},
            "decoder": params | {"gru": oracles.gru(gru)},
        },
        "batch_stats": {"seed_encoder": {"norm": oracles.statistics(norm)}},
    }
    run = jax.jit(lambda *args: small().apply(variables, *args, train=False, method=JointEmbedding.decode))
    oracles.assert_close(run(oracles.value(latent), oracles.value(seed)), oracles.value(out))
