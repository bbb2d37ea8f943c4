"""Joint Embedding: a coin decides which latent is decoded."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ha2g_jax.layers.tcn import TextEncoder
from ha2g_jax.layers.waveform import WaveformEncoder
from ha2g_jax.methods import joint_embedding
from ha2g_jax.methods.joint_embedding import ContextEncoder, JointEmbedding, l1
from ha2g_jax.train.step import step_keys


@pytest.fixture(scope="module")
def objective(make_objective):
    """An objective of short windows, as most of a step is their sound."""
    return make_objective("joint_embedding", model__context__layers=1, data__num_frames=17)


@pytest.fixture(scope="module")
def state(objective, draw_state):
    return draw_state(objective)


@pytest.fixture(scope="module")
def run(objective, state):
    """The generator in training mode: (batch, keys) -> poses, and the batch statistics afterwards."""

    def run(batch, keys):
        outputs, _, batch_stats = joint_embedding.run(
            objective.spec, state.generator.variables, batch, keys, train=True
        )
        return outputs.poses[-1], batch_stats

    return jax.jit(run)


def keys_of(spec, from_speech):
    """Return the keys of a step whose coin falls on one side."""
    for number in range(64):
        keys = step_keys(spec, jax.random.key(number), jnp.int32(0))
        if bool(jax.random.bernoulli(keys["coin"])) == from_speech:
            return keys
    raise AssertionError("64 tosses on one side")


def test_l1_sums_the_windows_and_averages_inside_them():
    poses = jnp.array([[[1.0, 2.0], [0.0, 0.0]], [[-1.0, 0.0], [0.5, 0.5]]])
    targets = jnp.array([[[0.0, 0.0], [0.0, 1.0]], [[0.0, 0.0], [0.0, 0.0]]])
    assert float(l1(poses, targets)) == (1 + 2 + 0 + 1) / 4 + (1 + 0 + 0.5 + 0.5) / 4


@pytest.mark.parametrize("from_speech", [True, False])
def test_a_coin_decides_which_latent_is_decoded(from_speech, objective, state, run, make_motion_batch):
    batch, keys = make_motion_batch(objective, 3), keys_of(objective.spec, from_speech)
    late = jnp.roll(batch["directions"][:, objective.spec.num_seed_frames :], 5, axis=1)
    changed = {
        "audio": batch | {"audio": -batch["audio"]},
        "directions": batch | {"directions": batch["directions"].at[:, objective.spec.num_seed_frames :].set(late)},
    }
    poses, batch_stats = run(batch, keys)
    influences = {name for name, other in changed.items() if not np.array_equal(run(other, keys)[0], poses)}
    assert influences == {"audio" if from_speech else "directions"}
    # Both encoders run whichever way it falls.
    for part in ("context", "pose_encoder"):
        before, after = (jax.tree.leaves(stats[part]) for stats in (state.generator.batch_stats, batch_stats))
        assert all(not np.array_equal(one, other) for one, other in zip(before, after, strict=True))


def test_evaluation_samples_the_latent_of_the_speech(objective, state, make_motion_batch):
    """For a batch of one, whatever the coin."""
    evaluate = jax.jit(
        lambda batch, keys: joint_embedding.run(
            objective.spec, state.generator.variables, batch, keys, train=False
        ).outputs.poses[-1]
    )
    batch = make_motion_batch(objective, 1)
    late = jnp.roll(batch["directions"][:, objective.spec.num_seed_frames :], 5, axis=1)
    other = batch | {"directions": batch["directions"].at[:, objective.spec.num_seed_frames :].set(late)}
    sides = [evaluate(batch, keys_of(objective.spec, from_speech)) for from_speech in (True, False)]
    assert sides[0].shape == (1, objective.spec.num_frames, objective.spec.skeleton.pose_dim)
    assert not np.array_equal(*sides)  # each has its own noise
    np.testing.assert_array_equal(evaluate(other, keys_of(objective.spec, False)), sides[1])
    assert not np.array_equal(evaluate(batch | {"audio": -batch["audio"]}, keys_of(objective.spec, False)), sides[1])


FRAMES, SEEDS = 34, 4


def small():
    text = TextEncoder(5, embedding_dim=4, channels=4, layers=1, feature_dim=3, receptive_field="causal")
    audio = WaveformEncoder(feature_dim=3)
    return JointEmbedding(audio, text, pose_dim=6, context_dim=8, hidden_dim=8, layers=2, dropout=0.0)


def test_style_is_the_noise_of_the_latent(oracles):
    model = small()
    speech = {"audio": jnp.zeros((3, 36_267)), "words": jnp.zeros((3, FRAMES), jnp.int32)}
    style, seed = jnp.zeros((3, 0)), jnp.zeros((3, SEEDS, 6))
    shapes = jax.eval_shape(lambda key: model.init(key, speech, None, seed, train=False), jax.random.key(0))
    rng = np.random.default_rng(0)  # compiling the initialisation takes long
    variables = {
        "params": jax.tree.map(lambda x: rng.normal(0, 0.3, x.shape).astype(np.float32), shapes["params"]),
        "batch_stats": jax.tree.map(lambda x: np.ones(x.shape, np.float32), shapes["batch_stats"]),
    }
    mean, log_variance, noise, other_noise = rng.normal(size=(4, 3, 32)).astype(np.float32)
    infer = jax.jit(
        lambda noise: model.apply(
            variables, (mean, log_variance), noise, style, seed, train=False, method=JointEmbedding.infer
        )
    )
    decode = jax.jit(
        lambda latent: model.apply(variables, latent, style, seed, train=False, method=JointEmbedding.decode)
    )
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
    oracles.assert_close(run(oracles.value(latent), jnp.zeros((3, 0)), oracles.value(seed)), oracles.value(out))
